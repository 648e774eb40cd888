"""Recordings of simulated flights: files that viewers can open, and values that are those of the simulation."""

import base64
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.cli.record import FlightRecorder
from aerial_gym.math.quaternion import quat_rotate
from tests.unit.sim2real.logs.foxglove_files import read_and_check

pytestmark = pytest.mark.usefixtures("few_rays")

pytest.importorskip("mcap")


def test_a_recording_holds_poses_goals_commands_and_sensors(tmp_path: Path) -> None:
    """Depth is in millimetres; a turning robot carries its camera."""
    robot = "base_quadrotor_with_camera"
    with task_registry.make_task("navigation_task", num_envs=2, device="cpu", seed=1, robot=robot) as task:
        recorder, gtd = FlightRecorder(task, tmp_path / "a.mcap"), task.env.gtd
        task.reset()
        states = []
        for _ in range(3):
            states.append([gtd[key][1].clone() for key in ("robot_position", "rotor_speed", "robot_actions")])
            depth = gtd["depth_range_pixels"][0, 0].numpy().copy()
            recorder.write_step(torch.zeros(2, dtype=torch.bool))
            task.step(torch.full((2, task.num_actions), 0.2))
        recorder.close()
        goal = task.target_position[1].tolist()
        names, absent = task.env.robot_manager.action_names, (gtd["obstacle_position"][0, :, 2] < -500.0).sum()
    seen = read_and_check(tmp_path / "a.mcap")
    assert [at for at, _ in seen["/env_1/state"]] == [round(k * task.env.dt * 1e9) for k in range(3)]
    for (_, state), (_, command), (position, speed, action) in zip(
        seen["/env_1/state"], seen["/env_1/command"], states, strict=True
    ):
        assert [state[f"p_{axis}"] for axis in "xyz"] == position.tolist()
        assert [state[f"rotor_{n}"] for n in range(1, 5)] == speed.tolist()
        assert [command[f"action_{name}"] for name in names] == action.tolist()
    assert list(seen["/env_1/goal"][-1][1]["pose"]["position"].values()) == pytest.approx(goal, abs=1e-6)
    image = seen["/env_0/base_depth_camera/depth"][-1][1]
    pixels = np.frombuffer(base64.b64decode(image["data"]), dtype="<u2").reshape(image["height"], image["width"])
    valid = (depth >= 0.2) & (depth < 10.0)
    np.testing.assert_allclose(pixels[valid] / 1000.0, depth[valid], atol=5.1e-4)
    assert (pixels[~valid] == 0).all()
    boxes = seen["/env_0/scene"][-1][1]["entities"][0]["cubes"]
    assert len(boxes) == 1 + len(gtd["obstacle_position"][0]) - int(absent)  # and the ground
    assert len(seen["/env_0/vehicle"][0][1]["entities"][0]["cylinders"]) == 4


def test_points_of_a_lidar_lie_on_the_walls_that_it_sees(tmp_path: Path) -> None:
    """The points of a recording, through its frames, are where rays from the sensor end."""
    with task_registry.make_task("lidar_navigation_task", num_envs=1, device="cpu", seed=1) as task:
        recorder = FlightRecorder(task, tmp_path / "a.mcap")
        task.reset()
        recorder.write_step(torch.ones(1, dtype=torch.bool))
        recorder.close()
        (name, caster), gtd = next(iter(task.env.sensor_manager.casters.items())), task.env.gtd
        distance = gtd["depth_range_pixels"][0, 0] * (caster.cfg.max_range if caster.cfg.normalize else 1.0)
        hit = (distance >= caster.cfg.min_range) & (distance < caster.cfg.max_range)
        rays = (caster.direction * distance[..., None])[hit]
        turn, place = caster.places.attitude[0, 0], caster.places.position[0, 0]
        body = quat_rotate(turn.expand(len(rays), 4), rays) + place
        world = quat_rotate(gtd["robot_orientation"][0].expand(len(rays), 4), body) + gtd["robot_position"][0]
    seen = read_and_check(tmp_path / "a.mcap")
    points = np.frombuffer(base64.b64decode(seen[f"/env_0/{name}/points"][0][1]["data"]), dtype="<f4").reshape(-1, 3)
    places = {one["child_frame_id"]: one for one in seen["/tf"][0][1]["transforms"]}
    for frame in (f"env_0/{name}", "env_0/base"):
        points = _apply(places[frame], points)
    np.testing.assert_allclose(points, world.numpy(), atol=1e-4)


def _apply(place: dict, points: np.ndarray) -> np.ndarray:
    turn = torch.tensor(list(place["rotation"].values()), dtype=torch.float64)
    turned = quat_rotate(turn.expand(len(points), 4), torch.from_numpy(points.astype(float)))
    return turned.numpy() + list(place["translation"].values())
