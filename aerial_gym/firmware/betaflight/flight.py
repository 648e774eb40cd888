"""Hover of many vehicles, each flown by its own instance of Betaflight, under one position controller.

    position --(PX4's position and attitude control, once per environment step)--> sticks --> firmware --> motors

Letters: E environments.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.px4.controller import Px4Controller
from aerial_gym.env_manager import SIMS
from aerial_gym.env_manager.sim_builder import environment_by_name
from aerial_gym.errors import ConfigError
from aerial_gym.firmware.betaflight.build import Progress
from aerial_gym.firmware.betaflight.environment import FirmwareEnv
from aerial_gym.interop import usual_settings
from aerial_gym.robots.catalog import robot_by_name

STEP_S = 0.01  # Environment step: period of the position controller [s]
SETTLED_SHARE = 0.5  # Share of a flight after which it counts as hover


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
    trajectory_sha256: str  # Of positions, attitudes and motor pulses of all steps: equal for equal flights
    ended: dict[int, str]  # Instances that ended early, by environment, with the reason


class PositionPilot:
    """Position control that gives thrust and body rates: the outer loops of ``px4_position_control``."""

    def __init__(self, env: FirmwareEnv) -> None:
        """Take the simulation; gains follow from its declared vehicle."""
        manager = env.robot_manager
        law = make_controller(
            CONTROLLERS.get("px4_position_control"), manager.declared, env.sim_cfg.gravity, dt=env.dt,
            control=manager.cfg.control,
        )  # fmt: skip
        assert isinstance(law, Px4Controller)
        self._law, self._state = law, manager.tensors.state
        self._memory = torch.zeros(env.num_envs, law.needs.outer)
        self._begins = torch.ones(env.num_envs, 1, dtype=torch.bool)

    def __call__(self, goal: Tensor) -> Tensor:
        """Return thrust (0 is hover) and body rates [rad/s], (E, 4), for position [m] and yaw [rad], (E, 4)."""
        setpoint, self._memory = self._law.outer(self._state, goal, self._memory, self._begins)
        self._begins.zero_()
        return torch.cat((setpoint[:, :1] / self._law.gains.position.hover - 1.0, setpoint[:, 1:]), dim=-1)


def make_hover_env(
    robot: str | Path, *, instances: int, exchange_hz: float, seed: int = 0, progress: Progress | None = None
) -> FirmwareEnv:
    """Return vehicles in empty space, each flown by its own instance of Betaflight."""
    steps = round(STEP_S * exchange_hz)
    if not 1000.0 <= exchange_hz <= 4000.0 or abs(steps - STEP_S * exchange_hz) > 1e-9:
        raise ConfigError(f"exchange_hz = {exchange_hz:g}: must be 1000, 2000 or 4000")
    return FirmwareEnv(
        controller=CONTROLLERS.get("betaflight_rate_control"), period=STEP_S / steps, progress=progress,
        sim=replace(SIMS.get("base_sim"), dt=STEP_S), robot=robot_by_name(robot), num_envs=instances,
        env=replace(environment_by_name("empty_env"), physics_steps_per_env_step=1), device=torch.device("cpu"), seed=seed,
    )  # fmt: skip


@usual_settings
@torch.no_grad()
def fly_hover(env: FirmwareEnv, *, duration: float, on_step: Callable[[float], None] | None = None) -> FirmwareFlight:
    """Fly all vehicles from random starts to the middle, and hold them there.

    Args:
        duration: Length of the flight [s].
        on_step: Receives the share of the flight that is done.
    """
    env.reset()
    pilot, goal, digest = PositionPilot(env), torch.zeros(env.num_envs, 4), sha256()
    position, attitude = env.gtd["robot_position"], env.gtd["robot_orientation"]
    steps = round(duration / env.dt)
    total, largest, count = torch.zeros(env.num_envs), torch.zeros(env.num_envs), 0
    begin = time.perf_counter()
    for step in range(steps):
        env.step(pilot(goal))
        for part in (position.numpy(), attitude.numpy(), env.group.replies["pulses"]):
            digest.update(part.tobytes())
        if step >= SETTLED_SHARE * steps:
            error = position.norm(dim=-1)
            total, largest, count = total + error, torch.maximum(largest, error), count + 1
        if on_step is not None:
            on_step((step + 1) / steps)
    wall = time.perf_counter() - begin
    flown = [each for each in range(env.num_envs) if each not in env.group.ended]
    return FirmwareFlight(
        instances=env.num_envs, duration_s=duration, exchange_hz=round(1.0 / env.sim_cfg.dt, 6), wall_s=wall,
        real_time_factor=duration / wall, aggregate_real_time_factor=len(flown) * duration / wall,
        hover_error_mean_m=float(total[flown].mean()) / count if flown and count else None,
        hover_error_max_m=float(largest[flown].max()) if flown and count else None,
        trajectory_sha256=digest.hexdigest(), ended=dict(env.group.ended),
    )  # fmt: skip
