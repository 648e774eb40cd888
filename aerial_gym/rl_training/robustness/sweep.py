"""Flights of a policy in all cells of a plan, with the same starts in every cell.

Letters: E environments, F flights of a cell.
"""

from collections.abc import Callable, Iterator
from typing import Protocol

import torch

from aerial_gym.rl_training.evaluation import fly_episodes
from aerial_gym.rl_training.policies.load import PolicyShapes, check_fits
from aerial_gym.rl_training.policies.policy import Pilot
from aerial_gym.rl_training.policy_task import PolicyTask
from aerial_gym.rl_training.robustness.cell import CellGroup, Plan
from aerial_gym.rl_training.robustness.lossy_pilot import LossyPilot
from aerial_gym.rl_training.robustness.result import CellFlights, Robustness, judge
from aerial_gym.task import Task
from aerial_gym.task.step.actor import DELAY


class CheckablePilot(Pilot, PolicyShapes, Protocol):
    """A policy that states the shapes of its inputs and outputs."""


def fly_cells(
    policy: CheckablePilot, flown: PolicyTask, plan: Plan, *, flights: int, trained_on: str,
    on_progress: Callable[[str, float], None] = lambda _stage, _share: None,
) -> Iterator[Robustness]:  # fmt: skip
    """Yield the result after every simulation; the last one is complete."""
    results: list[CellFlights] = []
    for number, group in enumerate(plan.groups):

        def progress(step: int, steps: int, number: int = number, label: str = group.cells[-1].label) -> None:
            on_progress(f"flying {label}", (number + step / steps) / len(plan.groups))

        results += _fly_group(policy, flown, group, flights, trained_on, progress)
        yield judge(results, plan)


def _fly_group(
    policy: CheckablePilot,
    flown: PolicyTask,
    group: CellGroup,
    flights: int,
    trained_on: str,
    progress: Callable[[int, int], None],
) -> Iterator[CellFlights]:
    with flown.make(len(group.cells) * flights, group.settings, robot=group.robot) as task:
        task.require_one_vehicle("robustness")
        check_fits(policy, task, trained_on)
        starts = torch.arange(flights, dtype=torch.int32, device=task.device)
        task.env.random.environment.copy_(starts.repeat(len(group.cells)))
        task.env.restart(task.env.seed)  # draws with these numbers
        _write_effects(task, group, flights)
        loss = torch.tensor([cell.loss for cell in group.cells], device=task.device).repeat_interleave(flights)
        pilot = LossyPilot(policy, loss, task.env.random) if any(cell.loss for cell in group.cells) else policy
        done = fly_episodes(pilot, task, on_start=lambda task: _set_delays(task, group, flights), on_step=progress)
    columns = (done.succeeded, done.crashed, done.final_error, done.total)
    rows = list(zip(group.cells, *(each.cpu().split(flights) for each in columns), strict=True))
    for number, (cell, succeeded, crashed, error, total) in enumerate(rows):
        unchanged = group.compared and number > 0 and torch.equal(total, rows[0][-1])
        yield CellFlights(cell, succeeded, crashed, error, unchanged)


def _write_effects(task: Task, group: CellGroup, flights: int) -> None:
    """Write the parameters of the cells; flight i of a cell has those of its variant i modulo their number."""
    columns: dict[str, list[str]] = {}
    for effect, _ in task.env.robot_manager.model.effects:
        columns[effect.name] = [each.name for each in effect.parameters]
    rows = {name: task.env.gtd.plain(f"effect_{name}").cpu().clone() for name in columns}
    for number, cell in enumerate(group.cells):
        for i, variant in enumerate(cell.variants):
            for (effect, parameter), value in variant.values.items():
                chosen = slice(number * flights + i, (number + 1) * flights, len(cell.variants))
                rows[effect][chosen, columns[effect].index(parameter)] = value
    for name in {effect for cell in group.cells for variant in cell.variants for effect, _ in variant.values}:
        task.env.gtd[f"effect_{name}"][:] = rows[name].to(task.device)
    task.env.robot_manager.take_writes()


def _set_delays(task: Task, group: CellGroup, flights: int) -> None:
    for number, cell in enumerate(group.cells):
        if cell.delay_steps is not None:
            task.values.own[DELAY][number * flights : (number + 1) * flights] = cell.delay_steps
