"""A policy that turns its own rotors, as C code: ``python examples/motor_commands.py OUT [SECONDS]``.

Trains tinyprop from scratch to fly to a point by the thrust of each rotor, flies it from fresh starts, and writes it as C99.
"""

import sys
from dataclasses import replace
from pathlib import Path

from aerial_gym import task_registry
from aerial_gym.export import export_policy
from aerial_gym.rl_training import evaluate, load_policy, load_settings, settings_for, train

TASK = "position_setpoint_task_sim2real_end_to_end"


def main(out: Path, seconds: float) -> None:
    """Train, evaluate, export."""
    cfg = load_settings(settings_for("ppo", TASK))
    train(replace(cfg, task=TASK, seed=16, max_time_s=seconds), out)
    with task_registry.make_task(TASK, num_envs=256, seed=1_000_003) as task:
        policy, _ = load_policy(out, device=task.device)
        result = evaluate(policy, task)
    error = result.final_error_mean_m
    print(
        f"{result.crash_rate:.1%} lost, the others end {'nowhere' if error is None else f'{error:.3f} m'} beside the target"
    )
    for written in export_policy(out, out / "export", ["c99"], name="motors"):
        told = written.not_checked or f"{written.largest_difference:.1e} from torch at most"
        print(f"{written.file}: {told}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 150.0)
