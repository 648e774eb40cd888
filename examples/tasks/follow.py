"""A figure eight, with its acceleration as a lead or without: ``python examples/tasks/follow.py OUT.png [STARTS [TASK ...]]``.

``LeePilot`` flies ``tracking_task`` and ``agile_tracking_task``, or others such as ``smooth_tracking_task``, from fresh starts.
Prints the distance in the last second [m] and draws the last two thirds of one flight each. Needs matplotlib
(``pip install 'aerial-gym[sim2real]'``).
"""

import sys
from collections.abc import Sequence

import torch
from lee_pilot import LeePilot
from matplotlib.figure import Figure
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.rl_training import Evaluation, evaluate


def fly(name: str, starts: int, *, lead: bool) -> tuple[Evaluation, Tensor, Tensor]:
    """Return the figures of all flights, and the paths of the first robot and its target [m], (steps, 3) each."""
    robot, target = [], []
    with task_registry.make_task(name, num_envs=starts, device="cpu", seed=1) as task:

        def keep(step: int, steps: int) -> None:
            if step < steps:  # after the last one another episode has begun
                robot.append(task.env.gtd["robot_position"][0].clone())
                target.append(task.target_position[0].clone())

        result = evaluate(LeePilot(task, lead=lead), task, on_step=keep)
    return result, torch.stack(robot), torch.stack(target)


def main(out: str, starts: int, names: Sequence[str]) -> None:
    """Print the errors, write the picture."""
    figure = Figure(figsize=(4.5 * len(names), 4.0), layout="constrained")
    panels = figure.subplots(1, len(names), sharex=True, sharey=True, squeeze=False)
    for name, axes in zip(names, panels[0], strict=True):
        for lead, label in ((False, "by its place and velocity"), (True, "and by its acceleration")):
            result, robot, target = fly(name, starts, lead=lead)
            error = "nowhere" if result.final_error_mean_m is None else f"{result.final_error_mean_m:.2f} m away"
            print(f"{name}, {label}: {result.crash_rate:.1%} lost, the others end {error}")
            late = len(robot) // 3
            axes.plot(*robot[late:, :2].T.numpy(), label=f"{label}: {error}")
        axes.plot(*target[late:, :2].T.numpy(), "k:", label="target")
        axes.set(title=name, xlabel="x [m]", ylabel="y [m]", aspect="equal")
        axes.legend(fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1.1))
    figure.savefig(out, dpi=80)


if __name__ == "__main__":
    starts = int(sys.argv[2]) if len(sys.argv) > 2 else 64
    main(sys.argv[1], starts, sys.argv[3:] or ("tracking_task", "agile_tracking_task"))
