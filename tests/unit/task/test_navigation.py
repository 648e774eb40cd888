"""The navigation task: its action, reward and observation by hand, its goals and starts, and how its episodes end."""

from dataclasses import replace
from math import cos, exp, pi, radians, sin, sqrt

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym import SENSORS, Task, task_registry
from aerial_gym.assets import ENVIRONMENTS, CollisionTest
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ActionCfg, CommandCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.task.terms.actions import forward_flight
from aerial_gym.task.terms.observations import direction_vehicle
from tests.refusals import assert_refused
from tests.repetitions import rare_values
from tests.unit.task.hover import build_task, term_reward


def make_cfg(cfg: TaskCfg, *, camera: bool = True, success_radius: float | None = None, **changes: object) -> TaskCfg:
    if not camera:
        blind = tuple(entry for entry in cfg.observations["policy"] if entry.term != "nearest_in_cells")
        cfg = replace(cfg, robot="base_quadrotor", observations={"policy": blind})
    goal = cfg.terminations["goal"]
    goal = replace(goal, params={"radius": success_radius or goal.params["radius"]})
    cfg = replace(cfg, terminations={**cfg.terminations, "goal": goal})
    return replace(cfg, **changes)


def make(num_envs: int = 6, *, seed: int = 0, camera: bool = False, **changes: object) -> Task:
    """Return the task; without its camera, which takes most of its time, unless asked for."""
    return build_task(make_cfg(task_registry.get("navigation_task"), camera=camera, **changes), num_envs, seed=seed)


CFG = task_registry.get("navigation_task")
RATIOS = (CFG.command.params["low"], CFG.command.params["high"])
ROUNDING = 2e-6  # Of distances below 20 m in float32 [m]


def make_state(
    position: list[float], *, prev_distance: float, actions: list[float] | None = None,
    prev_actions: list[float] | None = None, difficulty: float = 0.0,
    euler: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> dict[str, Tensor]:  # fmt: skip
    def row(values: list[float]) -> Tensor:
        return torch.tensor([values], dtype=torch.float64)

    return {
        "target_position": row([0.0] * 3),
        "robot_position": row(position),
        "robot_orientation": quat_from_euler(row(list(euler))),
        "robot_actions": row(actions or [0.0] * 4),
        "robot_prev_actions": row(prev_actions or actions or [0.0] * 4),
        "previous_distance": torch.tensor([prev_distance], dtype=torch.float64),
        "difficulty": torch.tensor(difficulty, dtype=torch.float64),
    }


def bells(d: float) -> float:
    return 5.0 * exp(-d * d / 3.5) + 5.0 * exp(-2.0 * d * d)


@pytest.mark.parametrize(("state", "expected"), [
    # at the goal, nothing moved, level 0: 5 + 5 + 20/20
    (make_state([0.0, 0.0, 0.0], prev_distance=0.0), 11.0),
    # half a metre away and 0.2 m closer than before: + 10 * 0.2
    (make_state([0.3, 0.0, -0.4], prev_distance=0.7), bells(0.5) + 2.0 + 19.5 / 20),
    # 0.2 m further than before: - 20 * 0.2
    (make_state([0.3, 0.0, -0.4], prev_distance=0.3), bells(0.5) - 4.0 + 19.5 / 20),
    # the same at the highest level: three times
    (make_state([0.3, 0.0, -0.4], prev_distance=0.3, difficulty=1.0), 3.0 * (bells(0.5) - 4.0 + 19.5 / 20)),
    # forward velocity changed by 1, upward by -1, yaw rate by 0.5, sideways does not count; level 0
    (
        make_state([0.0] * 3, prev_distance=0.0, actions=[2.0, 9.0, 0.0, 0.5], prev_actions=[1.0, 0.0, 1.0, 0.0]),
        11.0 + 0.8 * (exp(-3.333) + exp(-5.0) + exp(-3.33 / 4) - 3.0),
    ),
    # half way up the levels: k = 2, and half of the penalties of the command's own size
    (
        make_state([0.0, 0.0, 0.0], prev_distance=0.0, actions=[1.0, 9.0, -1.0, 0.5], difficulty=0.5),
        2.0 * 11.0 + 0.5 * (0.1 * (exp(-0.3) - 1.0) + 1.5 * (exp(-1.0) - 1.0) + 1.5 * (exp(-0.5) - 1.0)),
    ),
])  # fmt: skip
def test_reward_is_the_published_formula(state: dict[str, Tensor], expected: float) -> None:
    task = make(1)
    assert term_reward(task, state).item() == pytest.approx(expected, rel=1e-6)  # 1/3.5 has 7 digits in the file
    assert term_reward(task, state, crash=torch.tensor([True])).item() == -100.0


@pytest.mark.parametrize(("action", "command"), [
    ([-1.0, 0.7, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]),  # no speed
    ([1.0, 0.0, 0.0, -0.5], [2.0, 0.0, 0.0, 0.0]),
    ([0.0, 1.0, -1.0, 0.0], [sqrt(0.5), 0.0, sqrt(0.5), -pi / 3]),  # 1 m/s, 45 degrees up, to the right
    ([5.0, -2.0, 3.0, 0.0], [sqrt(2.0), 0.0, -sqrt(2.0), pi / 3]),  # clamped
])  # fmt: skip
def test_actions_are_speed_inclination_and_yaw_rate(action: list[float], command: list[float]) -> None:
    result = forward_flight(torch.tensor([action]), **CFG.action.params)
    torch.testing.assert_close(result, torch.tensor([command]), rtol=1e-6, atol=1e-6)


def test_direction_is_seen_from_the_heading_alone() -> None:
    """Facing +y (yaw 90 degrees), whatever the tilt: a goal at -x is on the left, one below stays below."""
    for tilt in (0.0, 0.4):
        state = make_state([3.0, 0.0, 4.0], prev_distance=0.0, euler=(tilt, -tilt, radians(90.0)))
        expected = torch.tensor([[0.0, 0.6, -0.8]], dtype=torch.float64)
        torch.testing.assert_close(target_direction(state), expected, rtol=0.0, atol=1e-9)
    assert (target_direction(make_state([0.0, 0.0, 0.0], prev_distance=0.0)) == 0.0).all()


def target_direction(state: dict[str, Tensor]) -> Tensor:
    return direction_vehicle(*(state[name] for name in ("target_position", "robot_position", "robot_orientation")))


def test_the_observation_is_laid_out_as_documented() -> None:
    policy = tuple(replace(entry, noise_std=0.0) for entry in CFG.observations["policy"])
    task = make(3, camera=True, observations={"policy": policy})
    obs, _ = task.reset()
    obs, *_ = task.step(torch.tensor([0.2, -0.5, 0.3, 0.0]).expand(3, 4))
    seen, gtd = obs["observations"], task.env.gtd
    assert seen.shape == (3, 81)
    assert task.observation_space["observations"].shape == (81,)
    assert task.action_space.shape == (4,)
    error = (task.target_position - gtd["robot_position"]).double()
    yaw = gtd["robot_euler_angles"][:, 2].double()
    forward = (torch.cos(yaw) * error[:, 0] + torch.sin(yaw) * error[:, 1]) / error.norm(dim=-1)
    torch.testing.assert_close(seen[:, 0].double(), forward, rtol=0.0, atol=1e-5)
    torch.testing.assert_close(seen[:, 3].double(), error.norm(dim=-1), rtol=0.0, atol=1e-5)
    torch.testing.assert_close(seen[:, 4:6], gtd["robot_euler_angles"][:, :2], rtol=0.0, atol=1e-5)
    assert (seen[:, 6] == 0.0).all()
    assert torch.equal(seen[:, 7:10], gtd["robot_body_linvel"])
    assert torch.equal(seen[:, 10:13], gtd["robot_body_angvel"])
    speed, up = 1.2, radians(45.0) * -0.5
    command = torch.tensor([speed * cos(up), 0.0, speed * sin(up), 0.3 * pi / 3])
    torch.testing.assert_close(seen[:, 13:17], command.expand(3, 4), rtol=1e-5, atol=1e-6)
    pixels = gtd["depth_range_pixels"][:, 0].numpy()
    for index, block in ((17, np.s_[:, :17, :30]), (24, np.s_[:, :17, 210:]), (73, np.s_[:, 119:, :30])):
        nearest = np.where(pixels[block] < 0.0, 10.0, pixels[block]).min(axis=(1, 2)) / 10.0
        np.testing.assert_allclose(seen[:, index].numpy(), nearest, rtol=1e-6)


def test_what_a_cell_without_a_distance_means_follows_from_the_sensor() -> None:
    """The camera of the task marks far and near alike by -1: such a cell is far. A normalised one tells them apart."""
    camera = SENSORS.get("base_depth_camera")
    assert camera.far_pixel == camera.near_pixel == -1.0
    sensors = make(1, camera=True).env.sensor_manager
    assert next(iter(sensors.casters.values())).cfg.largest_and_empty_share == (10.0, 1.0)


def scene_distance(task: Task, points: Tensor) -> Tensor:
    out = torch.full((len(points),), float("nan"))
    upright = torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(len(points), 4).contiguous()
    spheres = task.env.robot_manager.cfg.collision.spheres
    CollisionTest(task.env.asset_manager.scene, spheres, position=points, attitude=upright, distance_out=out).measure()
    return out


ALL = {name: ENVIRONMENTS.get(name) for name in ENVIRONMENTS.names()}
OPEN = (name for name, env in ALL.items() if env.track is None and env.vehicle_clearance == 0.0)
RARE = ("forest_env", "env_with_lidar_nav_obstacles", "landing_platform_env")


@pytest.mark.parametrize("name", rare_values(OPEN, RARE))
def test_no_episode_starts_or_aims_inside_or_near_an_obstacle(name: str) -> None:
    """1000 episodes in every environment; half of them begin in a masked reset within a step."""
    task = make(250, env=name, curriculum=None, episode_len_steps=1)
    clearance, low, high = ENVIRONMENTS.get(name).clearance, *RATIOS
    for episode in range(4):
        if episode % 2 == 0:
            task.reset()
        else:
            *_, terminated, truncated, _ = task.step(torch.tensor([-1.0, 0.0, 0.0, 0.0]).expand(250, 4))
            assert (terminated | truncated).all()
        goal = task.target_position
        assert (scene_distance(task, goal) >= clearance - ROUNDING).all()
        assert (task.env.gtd["robot_clearance"] >= clearance - ROUNDING).all()
        now = scene_distance(task, task.env.gtd["robot_position"].clone())  # also of what made room for the goal
        torch.testing.assert_close(task.env.gtd["robot_clearance"], now, rtol=0.0, atol=ROUNDING)
        lower, upper = task.env.gtd["env_bounds_min"], task.env.gtd["env_bounds_max"]
        share = (goal - lower) / (upper - lower)
        least, most = torch.tensor(low), torch.tensor(high)
        assert ((share >= least - 1e-5) & (share <= most + 1e-5)).all()
        assert (share.std(dim=0) > 0.2 * (most - least)).all()  # uniform has 0.29


def test_progress_counts_within_an_episode_only() -> None:
    task = make(8, episode_len_steps=3)
    task.reset()
    for _ in range(4):
        now = (task.target_position - task.env.gtd["robot_position"]).norm(dim=-1)
        assert torch.equal(task.values["previous_distance"], now)
        _, reward, *_ = task.step(torch.tensor([0.0, 0.0, 0.0, 0.0]).expand(8, 4))
        assert (reward.abs() < 10.0).all()  # a jump of metres would weigh 10 or 20 each


def test_each_episode_ends_as_success_crash_or_timeout() -> None:
    task = make(4, episode_len_steps=2)
    task.reset()
    state, stay = task.env.robot_manager.tensors.state, torch.tensor([-1.0, 0.0, 0.0, 0.0]).expand(4, 4)
    task.step(stay)
    state.lin_vel.zero_()
    state.position[0] = task.target_position[0] - torch.tensor([0.0, 0.6, 0.0])  # there
    state.position[1] = task.env.gtd["obstacle_position"][1, 0]  # inside a panel
    state.position[2] = task.target_position[2]
    task.env.gtd["sim_steps"][2] = 0  # there, but the episode goes on
    _, reward, terminated, truncated, info = task.step(stay)
    assert info["successes"].tolist() == [True, False, False, False]
    assert info["crashes"].tolist() == terminated.tolist() == [False, True, False, False]
    assert info["timeouts"].tolist() == [False, False, False, True]
    assert truncated.tolist() == info["time_outs"].tolist() == [True, False, False, True]
    assert (reward[1], task.env.gtd["sim_steps"].tolist()) == (-100.0, [0, 0, 1, 0])


def test_tasks_that_do_not_fit_together_are_refused() -> None:
    blind, attitude = {"camera": True, "robot": "base_quadrotor"}, {"controller": "lee_attitude_control"}
    flight = {"transform": "forward_flight", "params": {"max_speed": 2.0}}
    for changes, message in (
        (blind, "term 'nearest_in_cells': robot base_quadrotor has no camera or lidar"),
        ({"action": ActionCfg(**flight)}, "action forward_flight: parameter 'max_inclination' is missing"),
        (attitude, r"forward_flight: gives vx .*; controller lee_attitude_control takes thrust"),
        (attitude | {"action": ActionCfg()}, r"reward 'forward_change': term .* is about vx .*; controller lee_att"),
    ):
        assert_refused(ConfigError, message, make, 1, **changes)
    low, high = RATIOS
    for wrong in (((0.95, 0.1, 0.1), high), ((-0.1, 0.1, 0.1), high), (low, (0.94, 0.88, float("nan")))):
        params = dict(zip(("low", "high"), wrong, strict=True))
        with pytest.raises(ConfigError, match="command drawn_point: .* 0 <= low <= high <= 1"):
            make(1, command=CommandCfg(generator="drawn_point", params=params))
    with pytest.raises(UnknownNameError, match="no action 'backward_flight'. .*Known: affine, direct, forward_flight"):
        make(1, action=ActionCfg(transform="backward_flight"))
    goal = CFG.terminations["goal"]
    with pytest.raises(ConfigError, match=r"radius = 0.0: must be > 0"):
        replace(CFG, terminations={**CFG.terminations, "goal": replace(goal, params={"radius": 0.0})})
