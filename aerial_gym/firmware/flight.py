"""Hover of many vehicles, each flown by its own instance of a firmware, from random starts to the middle.

Letters: E environments.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch

from aerial_gym.env_manager import SIMS
from aerial_gym.env_manager.sim_builder import environment_by_name
from aerial_gym.errors import ConfigError
from aerial_gym.firmware.environment import FirmwareEnv
from aerial_gym.interop import usual_settings
from aerial_gym.robots.catalog import robot_by_name

STEP_S = 0.01  # Environment step of a hover [s]
APPROACH_SHARE, SETTLED_SHARE = 0.25, 0.5  # Shares of a flight: end of the straight approach, begin of hover
OnStep = Callable[[float], None]
"""Receives the share of the flight that is done."""


@dataclass(frozen=True, kw_only=True)
class FirmwareFlight:
    """Figures of a flight. Errors are of the second half, and of instances that flew to the end."""

    instances: int
    duration_s: float
    exchange_hz: float  # Exchanges of state and motors per second of simulated time
    wall_s: float  # Duration of the flight by the clock, without build and start
    real_time_factor: float  # Simulated time of each instance per time by the clock
    aggregate_real_time_factor: float  # The same of all instances together
    hover_error_mean_m: float | None
    hover_error_max_m: float | None
    trajectory_sha256: str  # Of positions, attitudes and motor commands of all steps: equal for equal flights
    ended: dict[int, str]  # Instances that ended early, by environment, with the reason


def count_steps(env: FirmwareEnv, duration: float) -> int:
    """Return the environment steps of a duration [s]; raise ``ConfigError`` unless it is at least one."""
    if not duration >= env.dt:
        raise ConfigError(f"duration = {duration:g} s: must be at least a step of {env.dt:g} s")
    return round(duration / env.dt)


@usual_settings
@torch.no_grad()
def fly_hover(env: FirmwareEnv, *, duration: float, on_step: OnStep | None = None) -> FirmwareFlight:
    """Fly all vehicles in a straight line from random starts to the middle, and hold them there, for ``duration`` [s]."""
    steps = count_steps(env, duration)
    env.reset()
    position, attitude, digest = env.gtd["robot_position"], env.gtd["robot_orientation"], sha256()
    start = torch.nn.functional.pad(position, (0, 1))
    total, largest, count = torch.zeros(env.num_envs), torch.zeros(env.num_envs), 0
    begin = time.perf_counter()
    for step in range(steps):
        env.step(env.position_action(start * max(0.0, 1.0 - step / (APPROACH_SHARE * steps))))
        for part in (position.numpy(), attitude.numpy(), env.motors):
            digest.update(part.tobytes())
        if step >= SETTLED_SHARE * steps:
            error = position.norm(dim=-1)
            total, largest, count = total + error, torch.maximum(largest, error), count + 1
        if on_step is not None:
            on_step((step + 1) / steps)
    wall = time.perf_counter() - begin
    flown = [each for each in range(env.num_envs) if each not in env.ended]
    return FirmwareFlight(
        instances=env.num_envs, duration_s=duration, exchange_hz=round(1.0 / env.sim_cfg.dt, 6), wall_s=wall,
        real_time_factor=duration / wall, aggregate_real_time_factor=len(flown) * duration / wall,
        hover_error_mean_m=float(total[flown].mean()) / count if flown and count else None,
        hover_error_max_m=float(largest[flown].max()) if flown and count else None,
        trajectory_sha256=digest.hexdigest(), ended=dict(env.ended),
    )  # fmt: skip


def hover_options(robot: str | Path, *, instances: int, seed: int) -> dict[str, Any]:
    """Return the options of ``FirmwareEnv`` for vehicles in empty space, with environment steps of ``STEP_S``."""
    return {
        "sim": replace(SIMS.get("base_sim"), dt=STEP_S), "robot": robot_by_name(robot), "num_envs": instances,
        "env": replace(environment_by_name("empty_env"), physics_steps_per_env_step=1), "device": torch.device("cpu"),
        "seed": seed,
    }  # fmt: skip
