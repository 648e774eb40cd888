"""The lidar navigation task: what it sees, its reward by hand, its starts and goals, and collisions.
The radar navigation task: how it differs from the lidar navigation task, and what it sees.
"""

from dataclasses import replace
from functools import cache, partial
from math import cos, exp, pi, radians

import pytest
import torch
from torch import Tensor

from aerial_gym import ROBOTS, Task, task_registry
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.rl_training import load_settings, settings_for
from tests.refusals import assert_refused
from tests.unit.task.hover import build_task, term_reward
from tests.unit.task.test_navigation import scene_distance

NAME = "lidar_navigation_task"
CFG = task_registry.get(NAME)


def make(num_envs: int = 4, **changes: object) -> Task:
    """Return the task without noise of its own, with the lidar of the Aerial Gym Simulator, which has none either."""
    quiet = {"policy": tuple(replace(entry, noise_std=0.0) for entry in CFG.observations["policy"])}
    cfg = replace(CFG, **{"robot": "base_quadrotor_with_dome_lidar", "observations": quiet} | changes)
    return build_task(cfg, num_envs, robot=replace(ROBOTS.get(cfg.robot), initial_state=cfg.start))


def put(task: Task, position: Tensor, *, yaw: float = 0.0) -> None:
    state = task.env.robot_manager.tensors.state
    state.position.copy_(position)
    state.attitude.copy_(quat_from_euler(torch.tensor([0.0, 0.0, yaw])))
    state.lin_vel.zero_()
    state.ang_vel.zero_()


def clear(task: Task) -> None:
    """Take away everything but the walls, which are the first rows."""
    task.env.asset_manager.scene.asset_state[:, 6:, 2] = -1000.0


def test_the_observation_is_laid_out_as_documented() -> None:
    task = make()
    task.reset()
    obs, *_ = task.step(torch.tensor([0.2, -0.5, 2.0, 0.3]).expand(4, 4))
    seen, gtd = obs["observations"], task.env.gtd
    assert seen.shape == (4, 337)
    assert task.observation_space["observations"].shape == (337,)
    error, yaw = (task.target_position - gtd["robot_position"]).double(), gtd["robot_euler_angles"][:, 2].double()
    away = error.norm(dim=-1)
    forward = (torch.cos(yaw) * error[:, 0] + torch.sin(yaw) * error[:, 1]) / away
    left = (-torch.sin(yaw) * error[:, 0] + torch.cos(yaw) * error[:, 1]) / away
    expected = torch.stack((forward, left, error[:, 2] / away, away), dim=-1)
    torch.testing.assert_close(seen[:, :4].double(), expected, rtol=0.0, atol=1e-5)
    torch.testing.assert_close(seen[:, 4:6], gtd["robot_euler_angles"][:, :2], rtol=0.0, atol=1e-5)
    turned = seen[:, 6].double() + yaw - task.values["target_yaw"].double()
    torch.testing.assert_close(torch.cos(turned), torch.ones(4, dtype=torch.float64), rtol=0.0, atol=1e-9)
    assert (seen[:, 6].abs() <= pi).all()
    assert torch.equal(seen[:, 7:10], gtd["robot_body_linvel"])
    assert torch.equal(seen[:, 10:13], gtd["robot_body_angvel"])
    command = torch.tensor([0.4, -1.0, 2.0, 0.3 * pi / 3])  # m/s², world, the third clamped; rad/s
    torch.testing.assert_close(seen[:, 13:17], command.expand(4, 4), rtol=1e-6, atol=1e-6)
    image = gtd["depth_range_pixels"][:, 0]
    nearest = torch.where(image < 0.0, 10.0, image).view(4, 16, 3, 20, 6).amin(dim=(2, 4))
    torch.testing.assert_close(seen[:, 17:], 1.0 / nearest.flatten(1), rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("yaw", [0.0, pi])
def test_the_lidar_sees_the_walls_where_they_are(yaw: float) -> None:
    """In an empty hall: behind the robot in the top row, left, right, floor and ceiling in the bottom row. Rows hold 3
    of 48 elevations, of which the highest is half a step of 90 deg / 47.5 below the zenith, which looks backwards, and
    the lowest is square to it. Columns hold 6 of 120 azimuths, from 180 deg (down), 90 (left), 0 (up), -90 (right) to
    -180; the ray next to each of these is half a step of 3 deg away. The sensor is 5 cm behind the middle."""
    task = make(2, env="env_with_lidar_nav_obstacles")
    task.reset()
    clear(task)
    low, high = task.env.gtd["env_bounds_min"], task.env.gtd["env_bounds_max"]
    behind = 0.0 if yaw == 0.0 else 1.0
    corner = torch.stack((low[:, 0] + behind * (high - low)[:, 0], low[:, 1], low[:, 2]), dim=-1)
    put(task, corner + torch.tensor([2.0 if yaw == 0.0 else -2.0, 3.0, 2.5]), yaw=yaw)
    seen = task._read_observation()["observations"][:, 17:].view(2, 16, 20)
    square = cos(radians(0.5 * 90.0 / 47.5))
    torch.testing.assert_close(seen[:, 0], torch.full((2, 20), square / 1.95), rtol=1e-4, atol=0.0)
    aside = cos(radians(1.5))
    width, height = (high - low)[:, 1], (high - low)[:, 2]
    near, far = torch.full((2,), 3.0), width - 3.0
    left, right = (far, near) if yaw == 0.0 else (near, far)
    for columns, distance in (((0, 19), torch.full((2,), 2.5)), ((5,), left), ((9, 10), height - 2.5), ((14,), right)):
        for column in columns:
            expected = (aside / distance).clamp_min(0.1)  # further than 10 m is 10 m
            torch.testing.assert_close(seen[:, 15, column], expected, rtol=2e-4, atol=0.0)


def test_cells_are_as_many_as_the_term_says() -> None:
    sizes = ((8, 10), (4, 5), (1, 1))
    policy = tuple(ObservationCfg(term="inverse_nearest", params={"rows": r, "columns": c}) for r, c in sizes)
    policy += (ObservationCfg(term="nearest_in_cells", params={"rows": 4, "columns": 5}),)
    policy += (ObservationCfg(term="nearest_in_8x8_cells"),)
    task = make(2, observations={"policy": policy})
    seen = task.reset()[0]["observations"]
    fine, coarse, one, share, _ = seen.split((80, 20, 1, 20, 64), dim=-1)
    assert torch.equal(fine.view(2, 4, 2, 5, 2).amax(dim=(2, 4)).flatten(1), coarse)
    assert torch.equal(fine.amax(dim=-1, keepdim=True), one)
    torch.testing.assert_close(coarse, 0.1 / share)
    assert len([name for name in task.values.own if name.endswith("_cells")]) == 4
    with pytest.raises(UnknownNameError, match="'inverse_nearest' reads 'nearest_in_0x8_cells'"):
        make(1, observations={"policy": (ObservationCfg(term="inverse_nearest", params={"rows": 0}),)})
    assert_refused(ConfigError, "'inverse_nearest': robot base_quadrotor has no", make, 1, robot="base_quadrotor")
    with pytest.raises(UnknownNameError, match="reads 'target_yaw'"):
        make(1, command=replace(CFG.command, generator="drawn_point"))


def at_the_goal(**changes: list[float]) -> dict[str, Tensor]:
    """Return a state at rest in the origin, the goal, with the wanted heading, far from everything."""
    rows = {
        "target_position": [0.0] * 3, "robot_position": [0.0] * 3, "robot_linvel": [0.0] * 3, "robot_body_angvel": [0.0] * 3,
        "robot_orientation": [0.0, 0.0, 0.0, 1.0], "robot_actions": [0.0] * 4, "robot_prev_actions": [0.0] * 4,
    } | changes  # fmt: skip
    values = {key: torch.tensor([row], dtype=torch.float64) for key, row in rows.items()}
    for key, number in (("target_yaw", 0.0), ("robot_clearance", 5.0), ("previous_clearance", 5.0)):
        values[key] = torch.tensor([number], dtype=torch.float64)
    return values | {"step_time": torch.tensor(0.1, dtype=torch.float64)}


SAME = [2.0, 0.0, 1.0, 0.5]


@pytest.mark.parametrize(("state", "free", "hard"), [
    # all that counts at the goal: 3 + 5 + 20/20 + 2 1.5 + 2 + 4 + 1.5
    (at_the_goal(), 19.5, 58.5),
    # the same command as before: sizes 0.1 (exp(-1.2) - 1), 0.15 (exp(-1) - 1), 0.15 (exp(-0.5) - 1), times c k
    (at_the_goal(robot_actions=SAME, robot_prev_actions=SAME), 19.5, 58.5 - 3.0 * 0.2237191),
    # another one: 0.3 (exp(-5 du²) - 1) for changes by 0.5 and -1, and the size of 0.5
    (
        at_the_goal(robot_actions=[0.0, 0.5, 0.0, 0.0], robot_prev_actions=[0.0, 0.0, 1.0, 0.0]),
        19.5 - 0.2140486 - 0.2979786,
        58.5 - 3.0 * (0.2140486 + 0.2979786 + 0.1 * (1.0 - exp(-0.075))),
    ),
    # 6 m away, straight to it at 2 m/s, backwards: 2 + 14/20, and what distances leave: nothing
    (at_the_goal(robot_position=[6.0, 0.0, 0.0], robot_linvel=[-2.0, 0.0, 0.0]), 2.7, 8.1),
    # the same nose first: 2 (exp(-32) - 1)
    (at_the_goal(robot_position=[-6.0, 0.0, 0.0], robot_linvel=[2.0, 0.0, 0.0]), 0.7, 2.1),
    # beside it at 4 m/s: -0.2 + 0.7 + 2 (exp(-2) - 1)
    (at_the_goal(robot_position=[6.0, 0.0, 0.0], robot_linvel=[0.0, 4.0, 0.0]), -1.2293294, -3.6879883),
])  # fmt: skip
def test_the_reward_is_the_published_formula(state: dict[str, Tensor], free: float, hard: float) -> None:
    """By hand, at the lowest and the highest level; sizes of commands count c k = c (1 + 2 c), all else k."""
    task = make(1)
    for difficulty, expected in ((0.0, free), (1.0, hard)):
        values = state | {"difficulty": torch.tensor(difficulty, dtype=torch.float64)}
        assert term_reward(task, values).item() == pytest.approx(expected, abs=2e-6)
        assert term_reward(task, values, crash=torch.tensor([True])).item() == -10.0
    half = term_reward(task, state | {"difficulty": torch.tensor(0.5, dtype=torch.float64)}).item()
    sizes = hard - 3.0 * free  # 3 at c = 1; at c = 0.5 it is 1
    assert half == pytest.approx(2.0 * free + sizes / 3.0, abs=2e-6)


def test_a_collision_soon_is_found_in_flight() -> None:
    """2 m/s towards the back wall, 0.5 s of it left after the step: -3 exp(-2 0.5⁴); the robot's hull reaches 0.184 m."""
    task = make(2)
    task.reset()
    clear(task)
    low = task.env.gtd["env_bounds_min"]
    put(task, low + torch.tensor([1.184 + 0.2, 3.0, 3.0]))
    task.env.robot_manager.tensors.state.lin_vel[0] = torch.tensor([-2.0, 0.0, 0.0])
    task.values["previous_clearance"].fill_(1.2)
    *_, info = task.step(torch.zeros(2, 4))
    soon = info["reward_terms"][:, task.reward_names.index("collision")]
    assert soon[0].item() == pytest.approx(-3.0 * exp(-0.125), abs=0.02)
    assert soon[1].item() > -1e-3  # at rest it falls a little at most
    torch.testing.assert_close(task.values["previous_clearance"], task.env.gtd["robot_clearance"])


def test_starts_have_any_heading_and_goals_keep_their_distance() -> None:
    task = make(250, robot="base_quadrotor", observations={"policy": (ObservationCfg(term="heading_error"),)})
    obs, _ = task.reset()
    gtd = task.env.gtd
    for angle in (gtd["robot_euler_angles"][:, 2], task.values["target_yaw"], obs["observations"][:, 0]):
        assert float(angle.min()) < -0.9 * pi < 0.9 * pi < float(angle.max())
    assert (gtd["robot_clearance"] >= 0.4 - 2e-6).all()
    share = (task.target_position - gtd["env_bounds_min"]) / (gtd["env_bounds_max"] - gtd["env_bounds_min"])
    low, high = torch.tensor([0.90, 0.15, 0.15]), torch.tensor([0.92, 0.80, 0.80])
    assert ((share >= low - 1e-5) & (share <= high + 1e-5)).all()
    assert (scene_distance(task, task.target_position) >= 0.4 - 2e-6).all()


RADAR_CFG = task_registry.get("radar_navigation_task")
SHARE = 0.8  # Of cells without a return


@cache
def task() -> Task:
    quiet = {"policy": tuple(replace(entry, noise_std=0.0) for entry in RADAR_CFG.observations["policy"])}
    made = build_task(replace(RADAR_CFG, observations=quiet), 16)
    made.reset()
    return made


@pytest.mark.slow
def test_it_is_the_lidar_task_but_for_what_it_says() -> None:
    *state, cells = RADAR_CFG.observations["policy"]
    unseen = RADAR_CFG.rewards["unseen"]
    told = (cells.term, cells.dropout, cells.dropout_value, unseen.params["looks"])
    assert told == ("inverse_nearest", SHARE, -1.0, 1.0)
    assert (RADAR_CFG.env, RADAR_CFG.robot, RADAR_CFG.start) == ("env_with_obstacles", "lmf2_radar", None)
    assert (RADAR_CFG.curriculum.min_level, RADAR_CFG.curriculum.max_level) == (25, task().env.asset_manager.num_assets)
    as_lidar = replace(
        RADAR_CFG,
        observations={"policy": (*state, replace(cells, dropout=0.0, dropout_value=0.0))},
        rewards={**RADAR_CFG.rewards, "unseen": replace(unseen, params={**unseen.params, "looks": -1.0})},
        curriculum=replace(RADAR_CFG.curriculum, max_level=CFG.curriculum.max_level),
        **{name: getattr(CFG, name) for name in ("env", "robot", "start", "summary", "source")},
    )
    assert as_lidar == CFG


@pytest.mark.slow
def test_the_held_task_differs_by_what_lost_cells_show() -> None:
    """Of 0.8^20 = 1.2 % of the cells at most nothing is seen after 20 steps; before that of 0.8^k."""
    held = task_registry.get("radar_navigation_task_held")
    *state, cells = held.observations["policy"]
    assert cells.hold_steps == 20
    given = {"policy": (*state, replace(cells, hold_steps=0))}
    assert replace(held, observations=given, summary=RADAR_CFG.summary, source=RADAR_CFG.source) == RADAR_CFG
    made = build_task(held, 16)
    made.reset()
    for _ in range(3):
        obs, *_ = made.step(torch.zeros(16, 4))
    lost = (obs["observations"][:, 17:] == -1.0).double()
    share = SHARE**4
    assert float((lost.mean() - share).abs()) < 5.0 * (share * (1.0 - share) / lost.numel()) ** 0.5


def test_settings_are_those_of_the_lidar_task_but_for_the_memory_of_the_held_radar() -> None:
    file = settings_for("ppo", "radar_navigation_task", device="cpu")
    assert file == settings_for("ppo", "lidar_navigation_task", device="cpu")
    assert load_settings(file).task == "lidar_navigation_task"  # the command line puts its own in this place
    assert settings_for("rl_games", "radar_navigation_task") == settings_for("rl_games", "position_setpoint_task")
    file = partial(settings_for, "ppo", "radar_navigation_task_held")
    lidar = {device: settings_for("ppo", "lidar_navigation_task", device=device) for device in ("meta", "cpu")}
    assert load_settings(file(device="meta")).task == "radar_navigation_task_held"
    numbers, rest = (load_settings(each).learner for each in (file(device="meta"), lidar["meta"]))
    assert replace(numbers, memory=rest.memory, horizon=rest.horizon) == rest
    assert (numbers.memory, numbers.horizon) == (2 * rest.memory, 2 * rest.horizon)
    assert file(device="cpu") == lidar["cpu"]
