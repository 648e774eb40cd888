"""A student of late and noisy sensors learns from a teacher that knows the truth: ``python examples/student_of_noise.py OUT``.

The student sees what the teacher sees, with noise and 10 to 20 ms late; what it lacks it has to remember.
"""

import sys
from dataclasses import replace
from pathlib import Path

from aerial_gym import task_registry
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.rl_training import evaluate, load_policy, load_settings, settings_for, train

HOVER = task_registry.get("position_setpoint_task")
NOISE = {"position_error_world": 0.05, "attitude": 0.02, "lin_vel_body": 0.2, "ang_vel_body": 0.1}
TASK = replace(
    HOVER,
    summary="position_setpoint_task with a group of what a student sees: late, and with noise",
    observations={
        **HOVER.observations,
        "student": tuple(ObservationCfg(term=term, noise_std=std, delay_steps=(1, 2)) for term, std in NOISE.items()),
    },
)


def main(out: Path, seconds: float) -> None:
    """Train a teacher, its student, and a student without a memory; fly them all."""
    name = f"{Path(__file__).resolve()}:TASK"
    teacher = replace(
        load_settings(settings_for("ppo", "position_setpoint_task")), task=name, max_time_s=seconds, seed=1
    )
    train(teacher, out / "teacher")
    settings = load_settings(settings_for("distill", "position_setpoint_task"))
    for student, memory in (("student", 64), ("forgetful", 0)):
        assert settings.distill is not None
        seen = replace(settings.distill, policy_keys=("student",), memory=memory)
        given = {"task": name, "teacher": str(out / "teacher"), "max_time_s": seconds, "seed": 1}
        train(replace(settings, distill=seen, **given), out / student)
    for run in ("teacher", "student", "forgetful"):
        with task_registry.make_task(name, num_envs=512, seed=1_000_003) as task:
            policy, _ = load_policy(out / run, device=task.device)
            result = evaluate(policy, task)
        error = result.final_error_mean_m
        print(f"{run}: {result.crash_rate:.1%} crash, the others end {error or float('nan'):.3f} m beside the target")


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 60.0)
