"""Accuracy of a control law without learning in position tasks: ``python examples/tasks/hold.py [STARTS [TASK ...]]``.

Flies each task from fresh starts by ``LeePilot``, with gains as they are derived and twice as quick, whatever the task takes:
attitude, velocities, accelerations, body rates, or the thrust of each rotor. ``position_setpoint_task_morphy_paper`` flies
as well, with the reward of the paper. Prints the share of lost flights [%], the distance of the others in the last second [m],
and the share that stays near the point [%].
"""

import sys
from collections.abc import Sequence

from lee_pilot import LeePilot

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate

TASKS = (
    "position_setpoint_task",
    "position_setpoint_task_sim2real",
    "position_setpoint_task_acceleration_sim2real",
    "position_setpoint_task_sim2real_end_to_end",
    "position_setpoint_task_sim2real_px4",
    "position_setpoint_task_morphy_stiff",
    "position_setpoint_task_morphy",
    "smooth_position_setpoint_task",
    "recovery_task",
    "gust_rejection_task",
)


def main(starts: int, tasks: Sequence[str]) -> None:
    """Fly the tasks, print a line for each flight."""
    for name in tasks:
        for quicker in (1.0, 2.0):
            with task_registry.make_task(name, num_envs=starts, device="cpu", seed=1) as task:
                result = evaluate(LeePilot(task, quicker=quicker), task)
            error = "nowhere" if result.final_error_mean_m is None else f"{result.final_error_mean_m:.3f} m beside it"
            told = f"{result.crash_rate:.1%} lost, the others end {error}, {result.settled_rate:.1%} stay within"
            print(f"{name}, {quicker:.0f} times as quick: {told} {result.success_radius_m} m")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 256, sys.argv[2:] or TASKS)
