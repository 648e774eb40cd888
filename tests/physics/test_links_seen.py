"""Links that move, as sensors see them and as sensors on them move: closed-form kinematics with signs, and differences.
The arm hinges 0.1 m before the body origin and reaches to x = 0.5 m in the reference pose, with a ball of 0.05 m at its
end."""

from collections.abc import Sequence
from dataclasses import replace
from math import cos, pi, radians, sin, tan

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from aerial_gym.assets import ENVIRONMENTS, CollisionTest, Scene
from aerial_gym.assets.collision import LinkGeometry
from aerial_gym.config.environment import EnvironmentCfg, PartCfg, ShapeCfg
from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg
from aerial_gym.config.loader import dump_yaml
from aerial_gym.config.robot import BoxCfg, CapsuleCfg, CollisionCfg, InitialStateCfg, RobotCfg, SphereCfg
from aerial_gym.config.sensor import CameraCfg, LidarCfg, RangeSensorCfg
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.config.shape import ROBOT_ID
from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import IMUS, RayCaster, make_images
from aerial_gym.sensors.mounts import Carrier
from aerial_gym.sensors.scan import column_group_ages
from tests.builders import simulation

pytestmark = pytest.mark.usefixtures("few_rays")

HINGE, END, RADIUS = 0.1, 0.5, 0.05
DOWN, LEFT = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
"""Axes about which a positive angle takes the arm down, or to the left."""

BALL = PartCfg(shape=ShapeCfg(kind="sphere", radius=RADIUS), position=(END, 0.0, 0.0), link="arm")
CAMERA = CameraCfg(
    summary="test camera", width=40, height=30, hfov_deg=90.0, min_range=0.0, max_range=20.0, kind="range",
    source="chosen for the test",
)  # fmt: skip
STILL = {
    f"{name}_{end}": (0.0, 0.0, 0.0) for name in ("euler", "lin_vel", "ang_vel") for end in ("low", "high")
}  # fmt: skip


def bending(*joints: JointCfg, floating: bool = False, **changes: object) -> RobotCfg:
    base, round_one = ROBOTS.get("base_quadrotor"), ((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1e-3))
    base = replace(base, body=replace(base.body, inertia=round_one))
    start = InitialStateCfg(position_ratio_low=(0.5,) * 3, position_ratio_high=(0.5,) * 3, **STILL)
    cfg = JointsCfg(layout=joints, floating=floating, source="invented")
    return replace(base, joints=cfg, initial_state=start, visible=True, visual=(BALL,), **changes)


def arm(axis: Sequence[float], angle: float, *, rate: float = 0.0, **changes: object) -> JointCfg:
    light = LinkCfg(mass=0.001, com=(0.15, 0.0, 0.0), inertia=((1e-6, 0.0, 0.0), (0.0, 1e-6, 0.0), (0.0, 0.0, 1e-6)))
    return JointCfg(
        name="arm", axis=tuple(axis), position=(HINGE, 0.0, 0.0), link=light,
        initial=(angle, angle), initial_rate=(rate, rate), **changes,
    )  # fmt: skip


def build(robot: RobotCfg, device: torch.device, *, env: EnvironmentCfg | None = None, num_envs: int = 2) -> EnvManager:
    manager = simulation(robot, env=env or ENVIRONMENTS.get("empty_env"), num_envs=num_envs, device=device, seed=1)
    manager.reset()
    return manager


def pixel_rays(cfg: CameraCfg) -> np.ndarray:
    half = tan(radians(cfg.hfov_deg) / 2)
    column = half * (1.0 - (2.0 * np.arange(cfg.width) + 1.0) / cfg.width)
    row = half * cfg.height / cfg.width * (1.0 - (2.0 * np.arange(cfg.height) + 1.0) / cfg.height)
    y, z = np.meshgrid(column, row)
    rays = np.stack((np.ones_like(y), y, z), axis=-1).reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def ball_range(centre: Sequence[float], rays: np.ndarray) -> np.ndarray:
    """Return the range of a ball of ``RADIUS`` along rays from the origin, inf for a miss: the smaller root."""
    along = rays @ np.asarray(centre)
    square = along**2 - np.dot(centre, centre) + RADIUS**2
    return np.where(square >= 0.0, along - np.sqrt(np.maximum(square, 0.0)), np.inf)


def take_image(manager: EnvManager, cfg: RangeSensorCfg, link: int = 0) -> RayCaster:
    gtd = manager.gtd
    state, rates = gtd["robot_link_state_tensor"][:, link], gtd["robot_link_body_angvel"][:, link]
    images = make_images(cfg, manager.num_envs, device=manager.device, poisoned=True)
    position, attitude, lin_vel, _ = state.split((3, 4, 3, 3), dim=-1)
    carrier = Carrier(number=link, position=position, attitude=attitude, lin_vel=lin_vel, ang_vel=rates)
    caster = RayCaster(cfg, manager.asset_manager.scene, images, carrier)
    caster.cast()
    return caster


@pytest.mark.parametrize(("axis", "angle"), [(DOWN, 0.4), (DOWN, -0.4), (LEFT, 0.4), (LEFT, -0.4)])
def test_a_camera_on_the_body_sees_a_bent_arm_at_its_pixel_and_range(axis, angle, device) -> None:
    manager = build(bending(arm(axis, angle), sensors=(SensorMountCfg(sensor="base_depth_camera"),)), device)
    out, aside = HINGE + (END - HINGE) * cos(angle), (END - HINGE) * sin(angle)
    centre = (out, 0.0, -aside) if axis == DOWN else (out, aside, 0.0)
    caster = take_image(manager, CAMERA)
    exact = ball_range(centre, pixel_rays(CAMERA)).reshape(CAMERA.height, CAMERA.width)
    seen = caster.images.segmentation
    for env in range(2):
        hit = (seen[env, 0] == ROBOT_ID).cpu().numpy()
        assert (hit == np.isfinite(exact)).all()
        assert hit.sum() > 10
        np.testing.assert_allclose(caster.images.distance[env, 0].cpu().numpy()[hit], exact[hit], atol=2e-6)
    rows, columns = np.nonzero(hit)
    mean = rows.mean() - 14.5 if axis == DOWN else 19.5 - columns.mean()  # below or left of the middle is positive
    assert mean * angle > 0.0
    manager.render()
    assert (manager.gtd["segmentation_pixels"] == ROBOT_ID).any()  # the camera of the robot file itself


def test_links_move_in_each_step_and_come_back_by_mask(device) -> None:
    manager = build(bending(arm(LEFT, -0.3, rate=3.0)), device)
    for step in range(1, 4):
        manager.step(torch.zeros(2, 4, device=device))
        angle = -0.3 + 3.0 * step * manager.dt
        torch.testing.assert_close(
            manager.gtd["dof_position"][:, 0].cpu(), torch.full((2,), angle), atol=1e-5, rtol=0.0
        )
        exact = ball_range(
            (HINGE + (END - HINGE) * cos(angle), (END - HINGE) * sin(angle), 0.0), pixel_rays(CAMERA)
        ).reshape(CAMERA.height, CAMERA.width)
        distance = take_image(manager, CAMERA).images.distance[0, 0].cpu().numpy()
        inside = np.isfinite(exact) & (distance < 20.0)
        assert inside.sum() > 10
        np.testing.assert_allclose(distance[inside], exact[inside], atol=2e-4)  # edges: 1e-5 rad of angle
    before = manager.gtd["robot_link_state_tensor"].clone()
    manager.reset(torch.tensor([False, True], device=device))
    after = manager.gtd["robot_link_state_tensor"]
    assert torch.equal(after[0], before[0])
    assert not torch.equal(after[1], before[1])


def test_the_frames_of_links_are_those_of_rotations_and_shifts_and_their_twists_the_differences(device) -> None:
    """A slide on a swing on a twist, on a body that flies: against rotation matrices of scipy, and central differences."""
    axes = (np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    points = (np.array([0.1, 0.0, 0.02]), np.array([0.2, 0.1, 0.0]), np.array([0.3, 0.1, 0.1]))
    reference = (0.2, 0.0, 0.05)
    joints = tuple(
        replace(
            arm(axis, 0.0), name=name, parent=parent, kind=kind, position=tuple(point), reference=ref, initial=None,
        )
        for axis, name, parent, kind, point, ref in zip(
            axes, ("arm", "wrist", "slide"), ("base", "arm", "wrist"), ("revolute", "revolute", "prismatic"), points,
            reference, strict=True,
        )
    )  # fmt: skip
    manager = build(bending(*joints, floating=True), device, num_envs=1)
    gtd, rng = manager.gtd, np.random.default_rng(3)
    place, turn = rng.normal(size=3), Rotation.from_rotvec(rng.normal(size=3))
    velocity, rates = rng.normal(size=3), rng.normal(size=3)
    angle, speed = np.array([0.7, -0.5, 0.12]), np.array([2.0, -1.5, 0.4])

    def frames(time: float) -> list[tuple[np.ndarray, Rotation]]:
        """Return the frames of the links a time later, the body turning about its own axes at a constant rate."""
        result = [(place + time * velocity, turn * Rotation.from_rotvec(time * rates))]
        for k in range(3):
            at, way = result[-1]
            bend = angle[k] + time * speed[k] - reference[k]
            if k < 2:
                own = Rotation.from_rotvec(bend * axes[k])
                result.append((at + way.apply(points[k] - own.apply(points[k])), way * own))
            else:
                result.append((at + way.apply(bend * axes[k]), way))
        return result

    for key, value in (
        ("robot_position", place), ("robot_orientation", turn.as_quat()), ("robot_linvel", velocity),
        ("robot_body_angvel", rates), ("dof_position", angle), ("dof_velocity", speed),
    ):  # fmt: skip
        gtd[key][:] = torch.as_tensor(value, dtype=torch.float32, device=device)
    manager._all_vehicles.move_links()
    state, own_rates = gtd["robot_link_state_tensor"][0].cpu().double().numpy(), gtd["robot_link_body_angvel"][0].cpu()
    step = 1e-5
    for k, (before, now, after) in enumerate(zip(frames(-step), frames(0.0), frames(step), strict=True)):
        np.testing.assert_allclose(state[k, :3], now[0], atol=1e-6)
        assert (Rotation.from_quat(state[k, 3:7]) * now[1].inv()).magnitude() < 1e-6
        np.testing.assert_allclose(state[k, 7:10], (after[0] - before[0]) / (2 * step), atol=5e-6)
        spin = (after[1] * before[1].inv()).as_rotvec() / (2 * step)
        np.testing.assert_allclose(state[k, 10:13], spin, atol=5e-6)
        np.testing.assert_allclose(own_rates[k].numpy(), now[1].inv().apply(spin), atol=5e-6)


@pytest.mark.parametrize("angle", [0.5, 0.9])
def test_a_camera_on_a_link_looks_where_its_arm_points(angle, device, tmp_path) -> None:
    """A beam along an arm that is bent down meets the ground at the height of the camera over the sine of the angle."""
    beam = replace(CAMERA, width=1, height=1, hfov_deg=0.1)
    (tmp_path / "beam.yaml").write_text(dump_yaml(beam))
    place = (END + 2 * RADIUS, 0.0, 0.0)
    mount = SensorMountCfg(sensor=str(tmp_path / "beam.yaml"), parent="arm", position=place)
    env = replace(ENVIRONMENTS.get("empty_env"), ground_height=-2.0)
    manager = build(bending(arm(DOWN, angle), sensors=(mount,)), device, env=env)
    manager.render()
    height = 2.0 - (END + 2 * RADIUS - HINGE) * sin(angle)
    result = manager.gtd["depth_range_pixels"].flatten().cpu()
    torch.testing.assert_close(result, torch.full((2,), height / sin(angle)), atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("rate", [4.0, -4.0])
def test_an_imu_on_a_link_feels_the_turn_about_its_hinge(rate, device, tmp_path) -> None:
    """Specific force -w² l along the arm and gravity up, gyro w: about a vertical axis, on a stand."""
    quiet = {name: (0.0, 0.0, 0.0) for name in vars(IMUS.get("base_imu")) if name.endswith(("density", "walk", "bias"))}
    (tmp_path / "quiet.yaml").write_text("model: imu\n" + dump_yaml(replace(IMUS.get("base_imu"), **quiet)))
    mount = SensorMountCfg(
        sensor=str(tmp_path / "quiet.yaml"), parent="arm", position=(END, 0.0, 0.0), euler=(0.0, 0.0, 0.0)
    )
    manager = build(bending(arm(LEFT, 0.0, rate=rate), sensors=(mount,)), device)
    for _ in range(5):
        manager.step(torch.zeros(2, 4, device=device))
    lever = END - HINGE
    expected = torch.tensor([-(rate**2) * lever, 0.0, 9.81, 0.0, 0.0, rate])
    turn = rate * manager.dt  # a difference over a step is less by its square over 24
    result = manager.gtd["imu_measurement"][0].cpu()
    torch.testing.assert_close(result, expected, rtol=0.0, atol=rate**2 * lever * turn**2 / 20 + 1e-3)


def flow_of_ball(manager: EnvManager, cfg: CameraCfg, link: int) -> Tensor:
    flow = take_image(manager, cfg, link).images.optical_flow
    return flow[0, 0, 0, 0].cpu()


@pytest.mark.parametrize("rate", [1.5, -1.5])
def test_the_image_of_a_swinging_arm_flows(rate, device) -> None:
    """Its nearest point moves left at w (l - r), 1 / (x - r) of that per focal length; a camera on the arm sees it at rest."""
    cfg = replace(CAMERA, width=1, height=1, hfov_deg=1.0, optical_flow=True)
    manager = build(bending(arm(LEFT, 0.0, rate=rate)), device)
    focal = 0.5 / tan(radians(0.5))
    expected = -focal * rate * (END - HINGE - RADIUS) / (END - RADIUS)
    torch.testing.assert_close(flow_of_ball(manager, cfg, 0), torch.tensor([expected, 0.0]), rtol=1e-5, atol=1e-4)
    assert flow_of_ball(manager, cfg, 1).abs().max() < 1e-6
    back = replace(cfg, euler=(0.0, 0.0, pi))  # from the arm away from it: nothing there, at infinity
    torch.testing.assert_close(flow_of_ball(manager, back, 1), torch.tensor([focal * rate, 0.0]), rtol=1e-5, atol=1e-3)


@pytest.mark.slow
def test_a_turning_lidar_sees_a_swinging_arm_where_it_was_at_each_column(device) -> None:
    """Each column as a lidar at rest sees the arm at the angle of that moment; from the arm itself it is in its place."""
    lidar = LidarCfg(
        summary="turning", width=36, height=9, azimuth_low_deg=-40.0, azimuth_high_deg=40.0, elevation_low_deg=-8.0,
        elevation_high_deg=8.0, min_range=0.0, max_range=10.0, scan_s=0.5, source="chosen for the test",
    )  # fmt: skip
    rate, angle = 2.0, 0.1
    image = take_image(build(bending(arm(LEFT, angle, rate=rate)), device), lidar).images.distance[0, 0]
    seen = 0
    for column, age in enumerate(column_group_ages(lidar)):
        still = build(bending(arm(LEFT, angle - rate * age)), device, num_envs=1)
        exact = take_image(still, replace(lidar, scan_s=None)).images.distance[0, 0, :, column]
        torch.testing.assert_close(image[:, column], exact, rtol=0.0, atol=1e-5)
        seen += int((exact < 10.0).sum())
    assert seen > 5
    on_arm = [
        take_image(build(bending(arm(LEFT, angle, rate=w)), device), cfg, link=1).images.distance[0]
        for w, cfg in ((rate, lidar), (0.0, replace(lidar, scan_s=None)))
    ]
    torch.testing.assert_close(*on_arm, rtol=0.0, atol=1e-6)


def test_what_sits_on_a_link_that_is_not_there_is_refused() -> None:
    rigid = ROBOTS.get("base_quadrotor")
    with pytest.raises(ConfigError, match=r"visual: part 1 sits on link 'arm': must be a link of the robot .base"):
        replace(rigid, visual=(BALL,))
    mount = SensorMountCfg(sensor="base_depth_camera", parent="leg")
    with pytest.raises(
        ConfigError, match=r"sensors: base_depth_camera sits on link 'leg': must be a link of the robot .base, arm"
    ):
        bending(arm(DOWN, 0.0), sensors=(mount,))
    with pytest.raises(ConfigError, match=r"only a robot has links"):
        ShapeCfg(kind="compound", parts=(BALL,))


ROD_RADIUS, LENGTH = 0.02, END - HINGE
ROD_OF_ARM = CapsuleCfg(
    radius=ROD_RADIUS, height=LENGTH, center=(0.5 * (HINGE + END), 0.0, 0.0), euler=(0.0, 0.5 * pi, 0.0), link="arm"
)
HULL = SphereCfg(center=(0.0, 0.0, 0.0), radius=0.05)


def fly(
    robot: RobotCfg, device: torch.device, *, ground: float | None = None, substeps: int = 1, backend: str = "auto"
) -> EnvManager:
    env = replace(ENVIRONMENTS.get("empty_env"), ground_height=ground, physics_steps_per_env_step=substeps)
    manager = simulation(robot, env=env, device=device, seed=1, backend=backend)
    manager.reset()
    return manager


def with_rod(axis: tuple[float, float, float], angle: float, rate: float = 0.0) -> RobotCfg:
    shapes = CollisionCfg(spheres=(HULL,), capsules=(ROD_OF_ARM,), source="invented")
    return bending(arm(axis, angle, rate=rate), collision=shapes)


@pytest.mark.parametrize("angle", [0.6, -0.6])
def test_the_clearance_counts_the_arm_where_it_is(angle, device) -> None:
    manager = fly(with_rod(DOWN, angle), device, ground=-0.3)
    expected = min(0.3 - LENGTH * sin(angle) - ROD_RADIUS, 0.3 - HULL.radius)
    torch.testing.assert_close(manager.gtd["robot_clearance"].cpu(), torch.full((2,), expected), atol=2e-6, rtol=0.0)
    deep = fly(with_rod(DOWN, 1.2), device, ground=-0.3).gtd["robot_clearance"]
    torch.testing.assert_close(deep.cpu(), torch.full((2,), 0.3 - LENGTH * sin(1.2) - ROD_RADIUS), atol=2e-6, rtol=0.0)
    assert (deep < 0.0).all()


@pytest.mark.parametrize("backend", ["warp", "torch"])
@pytest.mark.parametrize(("rate", "crashes"), [(30.0, True), (-30.0, False)])
def test_an_arm_that_touches_between_two_poses_crashes(rate, crashes, backend, device) -> None:
    """From 0.57 rad down through the ground and up behind, in one step of seven substeps; the other way it is clear."""
    if backend == "torch" and device.type == "cuda":
        pytest.skip("the same code as on a CPU")
    manager = fly(with_rod(DOWN, 0.57, rate=rate), device, ground=-0.35, substeps=7, backend=backend)
    assert (manager.gtd["robot_clearance"] > 0.0).all()
    manager.step(torch.zeros(2, 4, device=device))
    assert (manager.gtd["robot_clearance"] > 0.0).all()
    assert manager.gtd["crashes"].tolist() == [crashes] * 2


def test_each_link_is_measured_with_its_own_pose(device) -> None:
    ball = torch.tensor([[[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6]]], device=device)
    scene = Scene(
        [ShapeCfg(kind="sphere", radius=0.5)], shape_index=torch.zeros(1), semantic_id=torch.zeros(1), asset_state=ball
    )
    level = torch.tensor([[0.0, 0.0, 0.0, 1.0]], device=device)
    turned = torch.tensor([[0.0, 0.0, 0.5**0.5, 0.5**0.5]], device=device)  # x of the link along y of the world

    def position_row(x: float, y: float) -> torch.Tensor:
        return torch.tensor([[x, y, 0.0]], device=device)

    box = BoxCfg(size=(0.2, 0.4, 0.2), center=(0.3, 0.0, 0.0))
    links = [
        LinkGeometry(shapes=(box,), number=1, position=position_row(0.0, 0.9), attitude=turned),  # near face at y = 1.1
        LinkGeometry(
            shapes=(SphereCfg(center=(0.1, 0.0, 0.0), radius=0.1),),
            number=2, position=position_row(-2.0, 0.0), attitude=level,
        ),
    ]  # fmt: skip
    result = []
    for own in (links[:1], links[1:], links):
        out = torch.full((1,), float("nan"), device=device)
        body = {"position": position_row(3.0, 0.0), "attitude": level}
        CollisionTest(
            scene, (SphereCfg(center=(0.0, 0.0, 0.0), radius=0.2),), distance_out=out, links=own, **body
        ).measure()
        result.append(out.item())
    assert result == pytest.approx([0.6, 1.3, 0.6], abs=1e-6)


def two_arms(angle: float, rate: float = 0.0) -> RobotCfg:
    """Return arms along x at y = -0.1 and 0.1 that both turn to the left; the right one comes nearer."""
    right = replace(arm(LEFT, angle, rate=rate), name="right", position=(HINGE, -0.1, 0.0))
    left = replace(arm(LEFT, 0.0), name="left", position=(HINGE, 0.1, 0.0))
    rods = tuple(
        replace(ROD_OF_ARM, center=(0.5 * (HINGE + END), y, 0.0), link=name)
        for name, y in (("right", -0.1), ("left", 0.1))
    )
    shapes = CollisionCfg(spheres=(HULL,), capsules=rods, between_links=True, source="invented")
    joints = JointsCfg(layout=(right, left), floating=False, source="invented")
    return replace(bending(arm(LEFT, 0.0)), joints=joints, visual=(), collision=shapes)


def test_links_are_told_how_far_they_are_from_each_other(device) -> None:
    for angle in (0.0, 0.3, -0.3, 0.6):
        manager = fly(two_arms(angle), device)
        apart = 0.2 - LENGTH * sin(angle) if angle > 0.0 else 0.2
        result = manager.gtd["robot_link_clearance"].cpu()
        if angle == 0.6:
            assert (result < 0.0).all()
        else:
            torch.testing.assert_close(result, torch.full((2,), apart - 2 * ROD_RADIUS), atol=2e-5, rtol=0.0)
        manager.step(torch.zeros(2, 4, device=device))
        assert manager.gtd["crashes"].tolist() == [angle == 0.6] * 2


def test_links_that_pass_through_each_other_within_a_step_crash(device) -> None:
    """From -0.2 to 1.9 rad in one step of seven substeps: apart at both ends."""
    manager = fly(two_arms(-0.2, rate=30.0), device, substeps=7)
    manager.step(torch.zeros(2, 4, device=device))
    assert float(manager.gtd["dof_position"][0, 0]) == pytest.approx(1.9, abs=0.1)
    assert manager.gtd["crashes"].all()


def test_links_without_a_pair_and_shapes_without_a_link_are_refused() -> None:
    shapes = CollisionCfg(spheres=(HULL,), capsules=(ROD_OF_ARM,), between_links=True, source="invented")
    with pytest.raises(ConfigError, match="no pair of shapes to test"):
        fly(bending(arm(DOWN, 0.0), collision=shapes), torch.device("cpu"))
    rigid = replace(bending(arm(DOWN, 0.0)), joints=None, visual=(), visible=False)
    with pytest.raises(ConfigError, match="shape 1 sits on link 'arm': must be a link of the robot .base"):
        replace(rigid, collision=CollisionCfg(capsules=(ROD_OF_ARM,), source="invented"))
    with pytest.raises(ConfigError, match="between_links: the robot has no joints"):
        replace(rigid, collision=CollisionCfg(spheres=(HULL,), between_links=True, source="invented"))
