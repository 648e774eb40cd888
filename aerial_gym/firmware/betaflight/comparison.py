"""Comparison of ``betaflight_rate_control`` with Betaflight itself, for settings of its filters, gains and mixer.

Sticks and throttle are sums of sines, so that the vehicles tumble with saturated motors. They are whole microseconds, as
Betaflight reads them.
Letters: E environments.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from math import pi, radians
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.config.autopilots import BetaflightCfg
from aerial_gym.firmware.betaflight import vehicle as units
from aerial_gym.firmware.betaflight.environment import BetaflightEnv, make_hover_env
from aerial_gym.firmware.betaflight.settings import STICK_RATE
from aerial_gym.firmware.comparison import Difference, compare_flight
from aerial_gym.firmware.compiler import Progress

RISE_S = 0.5  # Time in which the sines grow from zero [s]
SPAN, HALF_SPAN = units.HIGH - units.LOW, units.HIGH - units.MIDDLE  # Of the pulses of throttle and sticks [us]
BASE = BetaflightCfg(
    p_roll=45.0, p_pitch=47.0, p_yaw=45.0, i_roll=80.0, i_pitch=84.0, i_yaw=80.0, tpa_rate=0.0
)  # fmt: skip
WITH_D = replace(BASE, d_roll=30.0, d_pitch=34.0)
SETTINGS: Mapping[str, BetaflightCfg] = {
    "P and I": BASE,
    "P alone": replace(BASE, i_roll=0.0, i_pitch=0.0, i_yaw=0.0),
    "D with two PT1 filters": WITH_D,
    "D with two BIQUAD filters": replace(WITH_D, dterm_lpf1_type="BIQUAD", dterm_lpf2_type="BIQUAD"),
    "gyro filter PT1, 100 Hz": replace(BASE, gyro_lpf1_static_hz=100.0),
    "gyro filter BIQUAD, 100 Hz": replace(BASE, gyro_lpf1_static_hz=100.0, gyro_lpf1_type="BIQUAD"),
    "I of yaw 250": replace(BASE, i_yaw=250.0),
    "no I-term relax": replace(BASE, iterm_relax="OFF"),
    "no airmode": replace(BASE, airmode=False),
    "TPA of P and D, 65 % from 1350": replace(WITH_D, tpa_mode="PD", tpa_rate=65.0),
}
"""Settings by name."""


def compare_settings(
    robot: str | Path = "racing_quadrotor", *, settings: Mapping[str, BetaflightCfg] = SETTINGS, duration: float = 4.0,
    instances: int = 4, seed: int = 0, progress: Progress | None = None,
) -> list[Difference]:  # fmt: skip
    """Return the difference of rotor commands for each setting, over ``instances`` random flights of ``duration`` [s]."""
    rows = []
    for number, (name, own) in enumerate(settings.items()):
        env = make_hover_env(robot, instances=instances, exchange_hz=1000.0, seed=seed, progress=progress, own=own)
        rows.append(compare_flight(env, name, _sines(env, round(duration / env.dt), seed)))
        if progress is not None:
            progress(f"comparing: {name}", (number + 1) / len(settings))
    return rows


def _sines(env: BetaflightEnv, steps: int, seed: int) -> Iterator[Tensor]:
    """Yield actions, (E, 4): sums of three sines each, to half stick up to 4 Hz, throttle 0 to 1 up to 2 Hz."""
    generator = torch.Generator().manual_seed(seed)
    rate, phase = (torch.rand(env.num_envs, 4, 3, generator=generator) for _ in range(2))
    highest = torch.tensor([2.0, 4.0, 4.0, 4.0])[:, None]
    for step in range(steps):
        waves = torch.sin(2.0 * pi * ((0.2 + rate * highest) * step * env.dt + phase)).mean(-1) * min(
            step * env.dt / RISE_S, 1.0
        )
        throttle = ((0.4 + 0.6 * waves[:, :1]).clamp(0.0, 1.0) * SPAN).round() / SPAN
        sticks = (0.5 * waves[:, 1:] * HALF_SPAN).round() / HALF_SPAN
        thrust = env.vehicle.thrust_of_throttle(throttle) - 1.0
        yield torch.cat((thrust, sticks * radians(STICK_RATE)), dim=-1)
