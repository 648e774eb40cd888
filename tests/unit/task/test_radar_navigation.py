"""The radar navigation task: how it differs from the lidar navigation task, and what it sees."""

from dataclasses import replace
from functools import cache, partial
from math import exp, pi

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from aerial_gym.rl_training import load_settings, settings_for
from tests.unit.task.hover import build_task
from tests.unit.task.rewards import term_reward
from tests.unit.task.test_lidar_navigation import CFG as LIDAR
from tests.unit.task.test_lidar_navigation import at_the_goal
from tests.unit.task.test_lidar_navigation import make as make_lidar

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
def test_the_observation_is_laid_out_as_documented() -> None:
    obs, *_ = task().step(torch.tensor([0.2, -0.5, 2.0, 0.3]).expand(16, 4))
    seen, gtd = obs["observations"], task().env.gtd
    assert seen.shape == (16, 337)
    assert task().observation_space["observations"].shape == (337,)
    torch.testing.assert_close(seen[:, 3], (task().target_position - gtd["robot_position"]).norm(dim=-1))
    torch.testing.assert_close(seen[:, 4:6], gtd["robot_euler_angles"][:, :2], rtol=0.0, atol=1e-5)
    turned = seen[:, 6] + gtd["robot_euler_angles"][:, 2] - task().values["target_yaw"]
    torch.testing.assert_close(torch.cos(turned), torch.ones(16))
    assert torch.equal(seen[:, 7:13], torch.cat((gtd["robot_body_linvel"], gtd["robot_body_angvel"]), dim=-1))
    command = torch.tensor([0.4, -1.0, 2.0, 0.3 * pi / 3])  # m/s², world, the third clamped; rad/s
    torch.testing.assert_close(seen[:, 13:17], command.expand(16, 4), rtol=1e-6, atol=1e-6)
    image = gtd["depth_range_pixels"][:, 0]
    nearest = torch.where(image < 0.0, 10.0, image).view(16, 16, 3, 20, 6).amin(dim=(2, 4)).flatten(1)
    cells = seen[:, 17:]
    returned = cells != -1.0
    torch.testing.assert_close(cells[returned], 1.0 / nearest[returned], rtol=1e-6, atol=0.0)
    assert returned.any()


@pytest.mark.slow
def test_so_many_cells_give_no_return() -> None:
    """Over 12 steps of 16 vehicles, and of each cell of the image, within 5 standard deviations of a binomial."""
    lost = torch.stack([task().step(torch.zeros(16, 4))[0]["observations"][:, 17:] == -1.0 for _ in range(12)]).double()
    for share, draws in ((lost.mean(), lost.numel()), (lost.mean(dim=(0, 1)), 12 * 16)):
        assert float((share - SHARE).abs().max()) < 5.0 * (SHARE * (1.0 - SHARE) / draws) ** 0.5
    same = (lost[1:] == lost[:-1]).double().mean().item()
    assert same == pytest.approx(SHARE**2 + (1.0 - SHARE) ** 2, abs=0.02)  # drawn anew at every step


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


def states(rows: int = 64) -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(0)

    def draw(*shape: int) -> Tensor:
        return torch.randn(rows, *shape, generator=generator, dtype=torch.float64)

    result = {name: draw(value.shape[1]) for name, value in at_the_goal().items() if value.ndim == 2}
    result["robot_orientation"] /= result["robot_orientation"].norm(dim=-1, keepdim=True)
    result |= {name: draw().abs() for name in ("robot_clearance", "previous_clearance")} | {"target_yaw": draw()}
    return result | {name: torch.tensor(0.5, dtype=torch.float64) for name in ("step_time", "difficulty")}


@pytest.mark.slow
def test_the_reward_differs_from_the_lidar_tasks_by_the_direction_alone() -> None:
    """2 (exp(-8 v²) - 1) (1 - exp(-2 d²)) of the speed v backwards, there ahead; doubled half way up the levels."""
    values = states()
    q, velocity = values["robot_orientation"], values["robot_linvel"]
    yaw = torch.atan2(2.0 * (q[:, 3] * q[:, 2] + q[:, 0] * q[:, 1]), 1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2))
    forward = torch.cos(yaw) * velocity[:, 0] + torch.sin(yaw) * velocity[:, 1]
    away = (values["target_position"] - values["robot_position"]).square().sum(-1)
    cost = 2.0 * (torch.exp(-8.0 * forward**2) - 1.0) * (1.0 - torch.exp(-2.0 * away))
    expected = 2.0 * torch.where(forward < 0.0, cost, -cost)
    result = term_reward(task(), values) - term_reward(make_lidar(1), values)
    torch.testing.assert_close(result, expected, rtol=0.0, atol=1e-9)
    assert float(result.abs().max()) > 3.0


@pytest.mark.slow
@pytest.mark.parametrize(("side", "expected"), [(-1.0, 2.7), (1.0, 2.7 + 2.0 * (exp(-32.0) - 1.0))])
def test_flight_ahead_costs_nothing(side: float, expected: float) -> None:
    """6 m away, straight to the goal at 2 m/s: 2 + 14/20, nose first; less 2 backwards."""
    state = at_the_goal(robot_position=[6.0 * side, 0.0, 0.0], robot_linvel=[-2.0 * side, 0.0, 0.0])
    values = state | {"difficulty": torch.tensor(0.0, dtype=torch.float64)}
    assert term_reward(task(), values).item() == pytest.approx(expected, abs=2e-6)


def test_it_is_trained_with_the_settings_of_the_lidar_task() -> None:
    file = settings_for("ppo", "radar_navigation_task", device="cpu")
    assert file == settings_for("ppo", "lidar_navigation_task", device="cpu")
    assert load_settings(file).task == "lidar_navigation_task"  # the command line puts its own in this place
    assert settings_for("rl_games", "radar_navigation_task") == settings_for("rl_games", "position_setpoint_task")


def test_the_held_radar_has_a_larger_memory_of_its_own_and_the_settings_of_the_lidar_task_on_a_cpu() -> None:
    file = partial(settings_for, "ppo", "radar_navigation_task_held")
    lidar = {device: settings_for("ppo", "lidar_navigation_task", device=device) for device in ("meta", "cpu")}
    assert load_settings(file(device="meta")).task == "radar_navigation_task_held"
    numbers, rest = (load_settings(each).learner for each in (file(device="meta"), lidar["meta"]))
    assert replace(numbers, memory=rest.memory, horizon=rest.horizon) == rest
    assert (numbers.memory, numbers.horizon) == (2 * rest.memory, 2 * rest.horizon)
    assert file(device="cpu") == lidar["cpu"]
