"""Comparison of ``betaflight_rate_control`` with Betaflight itself: motor signals for the same gyro rates and sticks.

There is no vehicle: rates, sticks and throttle are sums of sines. Both sides take the same rounded numbers: counts of the gyro,
microseconds of the sticks. The firmware averages the gyro's samples between two runs, half of which are still those of the
run before; so does the input of the controller here.
Letters: E environments, R rotors.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi, radians

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.autopilots import BetaflightCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.control.betaflight.controller import BetaflightController
from aerial_gym.firmware.betaflight import vehicle as units
from aerial_gym.firmware.betaflight.build import Progress, build_firmware
from aerial_gym.firmware.betaflight.instances import InstanceGroup
from aerial_gym.firmware.betaflight.launch import arm_instances
from aerial_gym.firmware.betaflight.settings import STICK_RATE, firmware_settings, store_settings
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.state import BodyState
from aerial_gym.robots.catalog import robot_by_name

PERIOD_S, STICK_PERIOD = 0.001, 20  # Time between runs [s]; runs between two frames of the sticks: 50 Hz
SPAN, HALF_SPAN = units.HIGH - units.LOW, units.HIGH - units.MIDDLE  # Of the pulses of throttle and sticks [us]
BASE = BetaflightCfg(
    p_roll=45.0, p_pitch=47.0, p_yaw=45.0, i_roll=80.0, i_pitch=84.0, i_yaw=80.0, tpa_rate=0.0, iterm_windup=100.0,
    pidsum_limit_yaw=500.0,
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
    "I of yaw 250, windup and limit as in 4.5": replace(BASE, i_yaw=250.0, iterm_windup=85.0, pidsum_limit_yaw=400.0),
    "no I-term relax": replace(BASE, iterm_relax="OFF"),
    "no airmode": replace(BASE, airmode=False),
    "TPA of P and D, 65 % from 1350": replace(WITH_D, tpa_mode="PD", tpa_rate=65.0),
}
"""Settings by name. In ``BASE`` windup and the limit of yaw are such that 4.5 and 4.6 do the same: 4.6
limits the integral of yaw to a share of ``pidsum_limit_yaw``, and does not slow it down."""


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference of motor signals, 0 to 1, between controller and firmware."""

    setting: str
    rms: float
    largest: float
    runs: int  # Compared runs of the loop, of all environments


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Inputs of both sides; rates about body axes, x forward, y left, z up."""

    ang_vel: Tensor  # [rad/s], (steps, E, 3)
    sticks: Tensor  # -1 to 1, (steps, E, 3)
    throttle: Tensor  # 0 to 1, (steps, E)


def make_inputs(num_envs: int, steps: int, *, seed: int = 0) -> Inputs:
    """Return sums of three sines that grow from zero: rates to 15 Hz, sticks to 4 Hz, throttle 0 to 1."""
    generator = torch.Generator().manual_seed(seed)
    time = PERIOD_S * torch.arange(steps, dtype=torch.float64)[:, None, None, None]

    def sines(width: int, highest: float, amplitude: float) -> Tensor:
        shape = (1, num_envs, width, 3)
        rate, phase = (torch.rand(shape, generator=generator, dtype=torch.float64) for _ in range(2))
        waves = torch.sin(2.0 * pi * (0.2 + rate * highest) * time + 2.0 * pi * phase).sum(-1) / 3.0
        return (time[..., 0] / 0.5).clamp_max(1.0) * amplitude * waves

    frames = torch.arange(steps) // STICK_PERIOD * STICK_PERIOD
    return Inputs(
        ang_vel=sines(3, 15.0, 4.0), sticks=sines(3, 4.0, 0.5)[frames],
        throttle=(0.4 + sines(1, 2.0, 0.6)[frames, :, 0]).clamp(0.0, 1.0),
    )  # fmt: skip


def compare_settings(
    robot: str = "racing_quadrotor", *, settings: Mapping[str, BetaflightCfg] = SETTINGS, duration: float = 4.0,
    num_envs: int = 4, seed: int = 0, progress: Progress | None = None,
) -> list[Difference]:  # fmt: skip
    """Return the difference of motor signals for each setting, over ``num_envs`` random inputs of ``duration`` [s]."""
    build = build_firmware(progress)
    vehicle_cfg = robot_by_name(robot)
    declared = vehicle_from_config(vehicle_cfg, num_envs=num_envs, device=torch.device("cpu"))
    inputs, rows = make_inputs(num_envs, round(duration / PERIOD_S), seed=seed), []
    for number, (name, cfg) in enumerate(settings.items()):
        controller = replace(CONTROLLERS.get("betaflight_rate_control"), betaflight=cfg)
        twin = make_controller(controller, declared, STANDARD_GRAVITY, dt=PERIOD_S, control=vehicle_cfg.control)
        assert isinstance(twin, BetaflightController)
        vehicle = units.BetaflightVehicle(twin, declared)
        lines = firmware_settings(cfg, twin.gains, period=PERIOD_S, yaw_reversed=vehicle.yaw_reversed)
        group = InstanceGroup.of_build(build, store_settings(build, lines), num_envs)
        try:
            arm_instances(group, vehicle, range(num_envs), period=PERIOD_S)
            difference = signal_differences(group, vehicle, inputs)
        finally:
            group.close()
        rows.append(Difference(
            setting=name, rms=float(difference.square().mean().sqrt()), largest=float(difference.abs().max()),
            runs=difference.shape[0] * num_envs,
        ))  # fmt: skip
        if progress is not None:
            progress(f"comparing: {name}", (number + 1) / len(settings))
    return rows


@torch.no_grad()
def signal_differences(group: InstanceGroup, vehicle: units.BetaflightVehicle, inputs: Inputs) -> Tensor:
    """Return controller minus firmware of the motor signals, (steps, E, R)."""
    twin, steps, rows = vehicle.twin, len(inputs.ang_vel), []
    sticks = (inputs.sticks * HALF_SPAN).round().div(HALF_SPAN).float()
    throttle = (inputs.throttle * SPAN).round().div(SPAN).float()
    num_envs = sticks.shape[1]
    memory, begins = torch.zeros(num_envs, twin.needs.inner), torch.ones(num_envs, 1, dtype=torch.bool)
    before, state = np.zeros((num_envs, 3)), _body_state(num_envs, twin)
    for step in range(steps):
        thrust = vehicle.thrust_of_throttle(throttle[step].unsqueeze(-1))
        setpoint = torch.cat((thrust, sticks[step] * radians(STICK_RATE)), dim=-1)
        vehicle.channels(setpoint - torch.tensor([1.0, 0.0, 0.0, 0.0]), group.requests["channels"])
        ang_vel = inputs.ang_vel[step].numpy()
        units.write_state(group.requests["state"], ang_vel=ang_vel)
        signal = vehicle.signals(group.exchange())
        counts = units.gyro_counts(ang_vel)
        state.ang_vel.copy_(torch.from_numpy(0.5 * (counts + before) / units.COUNTS_PER_RAD_S))
        before = counts
        speed, memory = twin.inner(state, setpoint, memory, begins)
        begins.zero_()
        rows.append(twin.signal_of_speed(speed) - signal)
    group.require(range(num_envs))
    return torch.stack(rows)


def _body_state(num_envs: int, twin: BetaflightController) -> BodyState:
    rest, attitude = torch.zeros(num_envs, 3), torch.tensor([[0.0, 0.0, 0.0, 1.0]]).expand(num_envs, -1)
    speed = torch.zeros(num_envs, twin.needs.num_rotors)
    return BodyState(position=rest, attitude=attitude, lin_vel=rest, ang_vel=rest.clone(), rotor_speed=speed)
