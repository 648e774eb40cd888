"""``python -m benchmarks.speed.libraries --trainer rl_games``: the share of a training's time in our step and copies.

The library trains as ``aerial-gym train`` does. Around each step of the adapter the device is waited for, so that the time of
a step is its whole time on host and device. The first 64 steps, which compile, do not count.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from typing import Any

import torch

from aerial_gym.rl_training import load_settings, settings_for, train
from aerial_gym.task import task_registry

ADAPTERS = {"rl_games": "TaskVecEnv", "sample_factory": "TaskBatchedEnv"}  # Class that a library steps, in its adapter

WARM_UP_STEPS = 64


class StepTimer:
    """Replaces the step of an adapter and adds up its time [s]."""

    def __init__(self, step: Callable[..., Any]) -> None:
        self._step = step
        self.steps, self.step_s, self.host_s = -WARM_UP_STEPS, 0.0, 0.0
        self.first = self.last = 0.0

    def __call__(self, env: object, actions: torch.Tensor) -> Any:
        wait = torch.cuda.synchronize if actions.is_cuda else (lambda: None)
        wait()
        begin = time.perf_counter()
        result = self._step(env, actions)
        on_host = time.perf_counter()
        wait()
        self.last = time.perf_counter()
        self.steps += 1
        if self.steps <= 0:
            self.first = self.last
        else:
            self.step_s += self.last - begin
            self.host_s += on_host - begin
        return result


def main() -> None:
    """Print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trainer", choices=tuple(ADAPTERS), default="rl_games")
    parser.add_argument("--task", default="position_setpoint_task")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--max-time-s", type=float, default=25.0)
    asked = parser.parse_args()
    task_registry.get(asked.task)
    adapter = getattr(import_module(f"aerial_gym.rl_training.adapters.{asked.trainer}"), ADAPTERS[asked.trainer])
    timed = StepTimer(adapter.step)
    adapter.step = lambda env, actions: timed(env, actions)
    cfg = replace(
        load_settings(settings_for(asked.trainer, asked.task, device=asked.device)),
        device=asked.device,
        max_time_s=asked.max_time_s,
        max_env_steps=None,
    )
    with tempfile.TemporaryDirectory() as out:
        result = train(cfg, f"{out}/run", show_progress=False)
    whole = timed.last - timed.first
    row = {
        "trainer": asked.trainer, "num_envs": cfg.num_envs, "env_steps_per_s": round(result.env_steps_per_s),
        "iteration_ms": round(1e3 * whole / timed.steps, 3), "step_ms": round(1e3 * timed.step_s / timed.steps, 3),
        "step_on_host_ms": round(1e3 * timed.host_s / timed.steps, 3), "share_of_step": round(timed.step_s / whole, 4),
    }  # fmt: skip
    print(json.dumps(row))


if __name__ == "__main__":
    main()
