"""The radar navigation task: how it differs from the lidar navigation task, and what it sees."""

from dataclasses import replace
from functools import cache, partial

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.rl_training import load_settings, settings_for
from tests.unit.task.hover import build_task
from tests.unit.task.test_lidar_navigation import CFG as LIDAR

CFG = task_registry.get("radar_navigation_task")
SHARE = 0.8  # Of cells without a return


@cache
def task() -> Task:
    quiet = {"policy": tuple(replace(entry, noise_std=0.0) for entry in CFG.observations["policy"])}
    made = build_task(replace(CFG, observations=quiet), 16)
    made.reset()
    return made


@pytest.mark.slow
def test_it_is_the_lidar_task_but_for_what_it_says() -> None:
    *state, cells = CFG.observations["policy"]
    unseen = CFG.rewards["unseen"]
    told = (cells.term, cells.dropout, cells.dropout_value, unseen.params["looks"])
    assert told == ("inverse_nearest", SHARE, -1.0, 1.0)
    assert (CFG.env, CFG.robot, CFG.start) == ("env_with_obstacles", "lmf2_radar", None)
    assert (CFG.curriculum.min_level, CFG.curriculum.max_level) == (25, task().env.asset_manager.num_assets)
    as_lidar = replace(
        CFG,
        observations={"policy": (*state, replace(cells, dropout=0.0, dropout_value=0.0))},
        rewards={**CFG.rewards, "unseen": replace(unseen, params={**unseen.params, "looks": -1.0})},
        curriculum=replace(CFG.curriculum, max_level=LIDAR.curriculum.max_level),
        **{name: getattr(LIDAR, name) for name in ("env", "robot", "start", "summary", "source")},
    )
    assert as_lidar == LIDAR


@pytest.mark.slow
def test_the_held_task_differs_by_what_lost_cells_show() -> None:
    """Of 0.8^20 = 1.2 % of the cells at most nothing is seen after 20 steps; before that of 0.8^k."""
    held = task_registry.get("radar_navigation_task_held")
    *state, cells = held.observations["policy"]
    assert cells.hold_steps == 20
    given = {"policy": (*state, replace(cells, hold_steps=0))}
    assert replace(held, observations=given, summary=CFG.summary, source=CFG.source) == CFG
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
