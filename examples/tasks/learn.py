"""Learn the tasks that no law in this folder flies: ``python examples/tasks/learn.py OUT [SECONDS [ENVIRONMENTS [TASK ...]]]``.

Trains each task from scratch for so long (start-up included, 150 s if not given) by the settings that come with it, in
OUT/TASK, and flies it from fresh starts.
Prints the share of flights that end as they should and of those that crash [%]. A GPU is taken where there is one.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from aerial_gym import task_registry
from aerial_gym.rl_training import evaluate, load_policy, load_settings, settings_for, train

TASKS = (
    "any_quadrotor_task",
    "motor_failure_task",
    "position_setpoint_task_reconfigurable",
    "dce_navigation_task",
    "radar_navigation_task",
    "radar_navigation_task_held",
    "racing_task",
    "racing_random_track_task",
)


def main(out: Path, seconds: float, num_envs: int | None, names: Sequence[str]) -> None:
    """Train and fly the tasks, print a line for each."""
    for name in names:
        cfg = load_settings(settings_for("ppo", name))
        given = replace(cfg, task=name, seed=1, num_envs=num_envs or cfg.num_envs, max_time_s=seconds)
        result = train(given, out / name)
        policy, _ = load_policy(out / name)
        rooms = task_registry.get(name).curriculum
        level = None if rooms is None else rooms.max_level
        with task_registry.make_task(name, num_envs=num_envs or 256, device="cpu", seed=1_000_003, level=level) as task:
            results = evaluate(policy, task)
        told = f"{results.success_rate:.1%} as they should, {results.crash_rate:.1%} crash"
        print(f"{name}: {told}, of {results.num_starts} flights after {result.env_steps:,} steps")


if __name__ == "__main__":
    numbers = sys.argv[2:4]
    seconds, num_envs = float(numbers[0]) if numbers else 150.0, int(numbers[1]) if len(numbers) > 1 else None
    main(Path(sys.argv[1]), seconds, num_envs, sys.argv[4:] or TASKS)
