"""Betaflight's parameters as rows of tensors, with defaults derived from the vehicle, and its filters.

Letters: E environments, R rotors.
"""

from dataclasses import dataclass
from math import radians

import torch
from torch import Tensor

from aerial_gym.config.autopilots import SCALES, YAW_INTEGRAL, BetaflightCfg
from aerial_gym.config.controller import ControlCfg, ControllerCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.control.filters.biquad import Biquad, butterworth
from aerial_gym.control.gains import frequency_ratio_of_loop, make_gains_with_timing
from aerial_gym.control.px4.cascade import smoothing_coefficient
from aerial_gym.control.timing import Timing
from aerial_gym.errors import ConfigError
from aerial_gym.physics.rotors import rotor_thrust, state_for_thrust
from aerial_gym.physics.vehicle import Vehicle

AXES = ("roll", "pitch", "yaw")


@dataclass(frozen=True, kw_only=True)
class BetaflightGains:
    """Gains of all environments, (E, 3) or (E, 1). Corrections are shares of the motors' range."""

    rate: Tensor  # Per rate error [s/rad]
    integral: Tensor  # Per integrated rate error [1/rad]
    derivative: Tensor  # Per measured angular acceleration [s²/rad]
    forward: Tensor  # Per slope of the wanted rate [s²/rad]
    limit: Tensor  # Of the correction
    integral_limit: Tensor  # Of the integral; 0 about axes without rotor torque
    mix: Tensor  # Scale of the allocation's columns: a correction of 1 uses the whole range of the most affected motor
    weight: Tensor  # Of the vehicle [N]
    center: Tensor  # Rate per stick about the centre [rad/s]
    largest: Tensor  # Rate at full stick [rad/s]
    expo: Tensor  # [-]


@dataclass(frozen=True, kw_only=True)
class BetaflightFilters:
    """Filters at the rate of the loop; None for an absent filter."""

    gyro: tuple[Biquad | None, Biquad | None]
    derivative: tuple[Biquad | None, Biquad | None]
    relax: float  # Low-pass coefficient of I-term relax: the share of the new value


def require_betaflight_vehicle(law: str, vehicle: Vehicle, allocation: Allocation) -> None:
    """Raise ``ConfigError`` for vehicles that Betaflight's mixer cannot fly."""
    if law != "rates":
        raise ConfigError(f"law {law!r}: Betaflight's rate loop follows body rates only. Take law: rates")
    if kinds := vehicle.traits & {"reversible", "force"}:
        raise ConfigError(
            f"law {law!r}: Betaflight's motors turn in one direction and take a share of their speed; rotors of this "
            f"vehicle are of another kind ({', '.join(sorted(kinds))}). Take lee_rates_control"
        )
    if bool((allocation.inverse[0, :, 2] <= 0.0).any()):
        raise ConfigError(
            f"law {law!r}: Betaflight's throttle needs rotors that all push up; some of this vehicle do not. Take "
            "lee_rates_control or fully_actuated_control"
        )


def derive_parameters(
    cfg: ControllerCfg, own: BetaflightCfg, control: ControlCfg, vehicle: Vehicle, allocation: Allocation, *,
    gravity: float, timing: Timing,
) -> BetaflightGains:  # fmt: skip
    """Derive the parameters for a declared vehicle, equal in all environments.

    Missing gains follow from ``control.gains``: the torque per rate error at hover, and an integral that is slower by a², with
    the a of that module.
    """
    base = make_gains_with_timing(cfg, control, vehicle, allocation, gravity=gravity, timing=timing)
    inverse = allocation.inverse[0].detach()
    largest = inverse[:, 3:].abs().amax(0)
    mix = torch.where(largest > 0.0, 1.0 / torch.where(largest > 0.0, largest, 1.0), 0.0)
    weight = float(vehicle.mass[0]) * gravity
    torque = (
        allocation_matrix(vehicle, gravity)[0, 3:] * thrust_per_signal(vehicle, inverse[:, 2] * weight)
    ) @ inverse[:, 3:]
    unit = torque.diagonal() * mix  # torque per correction [N m]
    rate, inertia = base.rate[0], vehicle.inertia[0].diagonal()
    turns = (rate > 0.0) & (unit > 0.0)
    some = torch.where(turns, unit, 1.0)
    slow = frequency_ratio_of_loop(control.phase_margin) ** 2
    derived = {"p": torch.where(turns, rate / some, 0.0)}
    derived["i"] = torch.where(turns, rate.square() / inertia / slow / some, 0.0)

    row = vehicle.rows_for_all_envs

    def gain(name: str) -> Tensor:
        given = [getattr(own, f"{name}_{axis}") for axis in AXES]
        unit = [SCALES[name]] * 3
        unit[2] *= YAW_INTEGRAL if name == "i" else 1.0
        return row([derived[name][k] if g is None else unit[k] * g for k, g in enumerate(given)])

    def axis_row(name: str, unit: float = 1.0) -> Tensor:
        return row([unit * getattr(own, f"{axis}_{name}") for axis in AXES])

    limit = mix.new_tensor([own.pidsum_limit, own.pidsum_limit, own.pidsum_limit_yaw]) / 1000.0
    most = own.iterm_windup / 100.0 * limit if own.version == "4.6" else own.iterm_limit / 1000.0
    return BetaflightGains(
        rate=gain("p"),
        integral=gain("i"),
        derivative=gain("d"),
        forward=gain("f"),
        limit=row(limit),
        integral_limit=row(most * (unit > 0.0)),
        mix=row(mix),
        weight=row([weight]),
        center=axis_row("center_sensitivity", radians(1.0)),
        largest=axis_row("max_rate", radians(1.0)),
        expo=axis_row("expo"),
    )


def thrust_per_signal(vehicle: Vehicle, thrust: Tensor) -> Tensor:
    """Return the slope of thrust per motor signal (0 to 1) at thrusts [N], both (R,)."""
    with torch.enable_grad():
        speed = state_for_thrust(vehicle, thrust.expand(vehicle.num_envs, -1)).detach().requires_grad_()
        (slope,) = torch.autograd.grad(rotor_thrust(vehicle, speed)[0].sum(), speed)
    return (slope * (vehicle.speed_high - vehicle.speed_low))[0]


def make_filters(own: BetaflightCfg, timing: Timing) -> BetaflightFilters:
    """Make the filters for the rate of the loop.

    Raises:
        ConfigError: If the cut-off of a second-order filter is not below half of that rate.
    """
    span = timing.loop * timing.dt

    def low_pass(name: str) -> Biquad | None:
        cutoff, kind = getattr(own, f"{name}_static_hz"), getattr(own, f"{name}_type")
        if cutoff == 0.0:
            return None
        if kind == "PT1":
            share = smoothing_coefficient(cutoff, span)
            return Biquad(share, 0.0, 0.0, share - 1.0, 0.0)
        if cutoff * span >= 0.5:
            raise ConfigError(
                f"BetaflightCfg.{name}_static_hz = {cutoff:g}: must be below half of the loop's {1.0 / span:g} Hz. "
                "Take 0 for no filter, PT1, or a smaller physics step (SimCfg.dt)"
            )
        return butterworth(cutoff, 1.0 / span)

    return BetaflightFilters(
        gyro=(low_pass("gyro_lpf1"), low_pass("gyro_lpf2")),
        derivative=(low_pass("dterm_lpf1"), low_pass("dterm_lpf2")),
        relax=smoothing_coefficient(own.iterm_relax_cutoff, span),
    )
