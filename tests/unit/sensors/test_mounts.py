"""Sensors in a robot file: what a mount may say, where it holds a sensor, and under which keys it measures."""

from dataclasses import replace
from itertools import pairwise
from math import pi
from pathlib import Path

import pytest
import torch

from aerial_gym.assets import Scene
from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import load_robot
from aerial_gym.config.sensor import CameraCfg, load_any_sensor
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.math.quaternion import euler_from_quat, quat_conjugate, quat_from_euler, quat_multiply
from aerial_gym.registry import GlobalTensorDictionary
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import IMUS, SENSORS, Pose, SensorManager, mounted_sensors, sensor_by_name
from aerial_gym.sensors.mounts import Carrier
from tests.builders import simulation
from tests.refusals import assert_refused

BASE = ROBOTS.get("base_quadrotor")
SIZE = {"width": 8, "height": 8, "hfov_deg": 90.0, "min_range": 0.0, "max_range": 10.0}
CAMERA = CameraCfg(summary="small", position=(0.1, 0.0, 0.0), source="chosen for the test", **SIZE)
LEVEL = torch.tensor([0.0, 0.0, 0.0, 1.0])


def boxes(places: list[list[float]], num_envs: int = 1) -> Scene:
    state = torch.zeros(num_envs, len(places), 13)
    state[..., :3], state[..., 6] = torch.tensor(places), 1.0
    rows, box = torch.arange(len(places)), ShapeCfg(kind="box", size=(1.5, 1.5, 1.5))
    return Scene([box] * len(places), shape_index=rows, semantic_id=rows, asset_state=state)


def manager(cfgs: dict, poses: dict, scene: Scene) -> tuple[SensorManager, GlobalTensorDictionary]:
    envs, device = scene.num_envs, torch.device("cpu")
    gtd = GlobalTensorDictionary(device=device, sizes={"E": envs})
    pose = {"position": torch.zeros(envs, 3), "attitude": LEVEL.repeat(envs, 1)}
    return SensorManager(cfgs, gtd, scene, Carrier(**pose), num_envs=envs, device=device, dt=0.01, poses=poses), gtd


def pose(position: tuple[float, float, float], roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    euler = torch.tensor([roll, pitch, yaw], dtype=torch.float64)
    return Pose(position=torch.tensor(position, dtype=torch.float64), attitude=quat_from_euler(euler))


def test_a_robot_file_mounts_names_files_and_poses(tmp_path: Path) -> None:
    (tmp_path / "tiny.yaml").write_text(dump_yaml(CAMERA), encoding="utf-8")
    imu = replace(IMUS.get("vn100"), summary="my own IMU")
    (tmp_path / "own_imu.yaml").write_text(dump_yaml(imu), encoding="utf-8")
    mounts = """
sensors:
  - depth_camera_64
  - {sensor: depth_camera_64, name: rear, position: [-0.1, 0.0, 0.0], euler: [0.0, 0.0, 3.1415927], rate_hz: 20.0}
  - tiny.yaml
  - vn100
  - {sensor: own_imu.yaml, name: tail, position: [-0.2, 0.0, 0.0], rate_hz: 50.0, latency_s: 0.02}
"""
    text = "\n".join(line for line in dump_yaml(BASE).splitlines() if not line.startswith("sensors:"))
    path = tmp_path / "robot.yaml"
    path.write_text(f"{text}\n{mounts}", encoding="utf-8")
    robot = load_robot(path)
    ranges, imus = mounted_sensors(robot.sensor_mounts)
    assert list(ranges) == ["depth_camera_64", "rear", "tiny"]
    assert ranges["depth_camera_64"].pose is None
    assert ranges["rear"].cfg == replace(SENSORS.get("depth_camera_64"), rate_hz=20.0)
    assert ranges["tiny"].cfg == CAMERA
    assert list(imus) == ["vn100", "tail"]
    assert imus["tail"].cfg == replace(imu, rate_hz=50.0, latency_s=0.02)
    again = tmp_path / "again.yaml"
    again.write_text(dump_yaml(robot), encoding="utf-8")
    assert load_robot(again) == robot


@pytest.mark.parametrize(("fields", "message"), [
    ({"name": "Front Camera"}, r"'Front Camera': must be snake_case"),
    ({"euler": (0.0, 0.0, 0.0), "quaternion": (0.0, 0.0, 0.0, 1.0)}, r"give it or quaternion"),
    ({"euler": (90.0, 0.0, 0.0)}, r"must lie within \+-2 pi"),
    ({"quaternion": (0.0, 0.0, 0.0, 0.0)}, r"must not be zero"),
    ({"position": (float("nan"), 0.0, 0.0)}, r"must be finite"),
    ({"rate_hz": 0.0}, r"rate_hz = 0.0: must be > 0"),
    ({"latency_s": -0.1}, r"latency_s = -0.1: must be >= 0"),
])  # fmt: skip
def test_impossible_mounts_are_refused(fields: dict, message: str) -> None:
    assert_refused(ConfigError, message, SensorMountCfg, sensor="base_lidar", **fields)


def test_equal_names_unknown_sensors_and_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"two mounts are named 'base_lidar'. Give one a name of its own"):
        replace(BASE, sensors=("base_lidar", SensorMountCfg(sensor="base_lidar", position=(0.0, 0.0, 0.1))))
    assert_refused(ConfigError, r"two mounts are named 'vn100'", replace, BASE, imu="vn100", sensors=("vn100",))
    with pytest.raises(UnknownNameError, match=r"no sensor 'bmi08'. Did you mean 'bmi088'\? Known: base_depth_camera"):
        sensor_by_name("bmi08")
    (tmp_path / "odd.yaml").write_text("model: sonar\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"model = 'sonar': must be one of pinhole, .*, imu"):
        load_any_sensor(tmp_path / "odd.yaml")


def test_a_camera_rolled_by_90_degrees_sees_the_left_at_the_bottom() -> None:
    ahead = [4.0, 0.0, 0.0]
    scene = boxes([ahead, [4.0, 2.0, 0.0], [4.0, 0.0, 2.0]])
    sensors, gtd = manager({"camera": CAMERA}, {"camera": pose((0.0, 0.0, 0.0), roll=0.5 * pi)}, scene)
    sensors.capture()
    ids = gtd["segmentation_pixels"][0, 0]
    rows, columns = torch.meshgrid(torch.arange(8.0) - 3.5, torch.arange(8.0) - 3.5, indexing="ij")
    assert (rows[ids == 1] > 0.0).all()  # left of the body: below
    assert (columns[ids == 2] < 0.0).all()  # above the body: left
    assert (ids == 1).any()
    assert (ids == 2).any()


def test_what_is_drawn_deviates_from_the_mount_along_its_own_axes() -> None:
    """``T_mount T_nominal^-1 T_drawn``: a shift to the sensor's left goes up where the mount is rolled by +90 degrees."""
    shifted = replace(CAMERA, position_low=(0.1, 0.0, 0.0), position_high=(0.1, 0.05, 0.0))
    turned = replace(shifted, euler_low=(0.0, 0.0, 0.0), euler_high=(0.0, 0.0, 0.2))
    sensors, _ = manager({"camera": turned}, {"camera": pose((0.3, 0.2, 0.1), roll=0.5 * pi)}, boxes([[4.0, 0, 0]], 64))
    sensors.reset(torch.ones(64, dtype=torch.bool))
    caster = sensors.casters["camera"]
    x, y, z = caster.places.position[:, 0].unbind(-1)
    torch.testing.assert_close(x, torch.full_like(x, 0.3))
    torch.testing.assert_close(y, torch.full_like(y, 0.2))
    assert ((z >= 0.1 - 1e-6) & (z <= 0.15 + 1e-6)).all()
    assert z.std() > 0.01
    rolled = quat_from_euler(torch.tensor([0.5 * pi, 0.0, 0.0])).expand(64, 4)
    own = euler_from_quat(quat_multiply(quat_conjugate(rolled), caster.places.attitude[:, 0]))
    torch.testing.assert_close(own[:, :2], torch.zeros(64, 2), rtol=0.0, atol=1e-6)
    yaw = own[:, 2]
    assert ((yaw >= -1e-6) & (yaw <= 0.2 + 1e-6)).all()  # about the camera's own z, which is minus the body's y
    assert yaw.std() > 0.03


def test_a_mount_in_the_nominal_place_changes_nothing() -> None:
    cfg = replace(
        CAMERA, euler=(0.4, -0.3, 1.0), position_low=(0.0, -0.1, -0.2), position_high=(0.2, 0.3, 0.1),
        euler_low=(0.3, -0.4, 0.9), euler_high=(0.5, -0.2, 1.3),
    )  # fmt: skip
    result = []
    for given in (None, pose(cfg.position, *cfg.euler)):
        sensors, _ = manager({"camera": cfg}, {"camera": given}, boxes([[4.0, 0.0, 0.0]], 16))
        sensors.reset(torch.ones(16, dtype=torch.bool))
        result.append((sensors.casters["camera"].places.position, sensors.casters["camera"].places.attitude))
    for plain, mounted in zip(*result, strict=True):
        torch.testing.assert_close(plain, mounted, rtol=0.0, atol=3e-7)


def test_two_equal_cameras_and_two_equal_imus_measure_apart() -> None:
    ahead = SensorMountCfg(sensor="depth_camera_64", position=(0.2, 0.0, 0.0))
    rear = replace(ahead, name="rear", position=(-0.2, 0.0, 0.0), quaternion=(0.0, 0.0, 2.0, 0.0))
    tail = SensorMountCfg(sensor="base_imu", name="tail", position=(-0.2, 0.0, 0.0), rate_hz=50.0, latency_s=0.02)
    env = simulation(replace(BASE, sensors=(ahead, rear, "base_imu", tail)), env="landing_env")
    env.reset()
    gtd = env.gtd
    gtd["robot_position"].copy_(torch.tensor([[0.0, 0.0, 1.5]]).expand(2, 3))
    for pitch, near, far in ((0.5, "", "rear_"), (-0.5, "rear_", "")):  # nose down: the ground fills the front image
        gtd["robot_orientation"].copy_(quat_from_euler(torch.tensor([0.0, pitch, 0.0])).repeat(2, 1))
        env.render()
        shares = [(gtd[f"{prefix}segmentation_pixels"] >= 0).float().mean() for prefix in (near, far)]
        assert shares[0] > 0.6
        assert 0.0 < shares[1] < 0.3
    gtd["robot_orientation"].copy_(LEVEL.repeat(2, 1))
    env.imus.reset(torch.ones(2, dtype=torch.bool))
    seen = []
    for _ in range(6):
        env.step(torch.zeros(2, 4))
        seen.append((gtd["imu_measurement"][0].clone(), gtd["tail_imu_measurement"][0].clone()))
    assert all(not torch.equal(a[0], b[0]) for a, b in pairwise(seen))
    assert torch.equal(seen[0][1], seen[1][1])
    assert "rear_segmentation_pixels" in str(gtd)
