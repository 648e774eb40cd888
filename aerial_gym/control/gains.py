"""Controller gains derived from the vehicle's inertia, rotor lag and thrust limits, and from the time step.

Both loops have the form ``1 / (s² (T s + 1))`` with all small lags in one T. A proportional and derivative law around it is
best placed about the crossover ``1 / (a T)``, half way between its zero at ``1 / (a² T)`` and the lag at ``1 / T``: the phase
margin there is ``atan a - atan 1/a`` and the largest that this T allows. It gives the natural frequency ``1 / (a^1.5 T)`` and
the damping ratio ``sqrt(a) / 2``.

- Attitude: T is the rotor lag plus one time step (half a step of hold on average, and less than half from the integrator).
- Position: T is the lag of the closed attitude loop, ``2 z / w``, which gives the same margin.

Source: Kessler (1958), Das symmetrische Optimum, Regelungstechnik 6, 395-400; in English Preitl, Precup (1999), An extension of
tuning relations after symmetrical optimum method for PI and PID controllers, Automatica 35(10), 1731-1736 (a² is beta there).
Frames: body is x forward, y left, z up; world is z up. Letters: E environments, R rotors.
"""

from dataclasses import replace
from math import acos, pi, tan
from typing import Any

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg, LeeGainsCfg
from aerial_gym.config.randomize import LARGEST_NORMAL, RandomizeCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.lee import LeeGains
from aerial_gym.errors import ConfigError
from aerial_gym.physics.law_memory import Timing
from aerial_gym.physics.vehicle import Vehicle, move_rows, own_rows, share_row

GAINS = ("position", "velocity", "attitude", "rate")  # Fields of `LeeGains` that may be given and drawn, each (E, 3)
LARGEST_INCLINATION = pi / 3  # Largest tilt with ample thrust [rad]. Source: Aerial Gym Simulator 2.0.1


LEAST_GRAVITY = 1.0  # Least apparent gravity of laws that tilt [m/s²], for a lateral acceleration of 1.7 m/s² at most


def frequency_and_damping(lag: float, phase_margin: float) -> tuple[float, float]:
    """Return natural frequency [rad/s] and damping ratio of a loop with a lag T [s] and a phase margin [rad].

    Source: Kessler (1958), symmetrical optimum: ``a = tan(pi/4 + margin/2)``, ``w = a^-1.5 / T``, ``z = sqrt(a) / 2``.
    """
    spacing = frequency_ratio_of_loop(phase_margin)
    return 1.0 / (spacing**1.5 * lag), 0.5 * spacing**0.5


def frequency_ratio_of_loop(phase_margin: float) -> float:
    """Return the frequency ratio a between zero, crossover and lag of a loop with a phase margin [rad]."""
    return tan(0.25 * pi + 0.5 * phase_margin)


def derive_gains(
    cfg: ControlCfg, vehicle: Vehicle, allocation: Allocation, *, gravity: float, dt: float, extra_lag: float = 0.0
) -> LeeGains:
    """Derive the gains of a declared vehicle, equal in all environments.

    The bandwidth of attitude about each axis is limited by torque: the largest attitude error, 1, needs no more than the
    rotors give at hover (``sqrt`` of the angular acceleration). So weak yaw is slow, and without yaw torque it is uncontrolled.

    Args:
        extra_lag: Additional delay of attitude over body rates [s]; it slows attitude and leaves the rate gain unchanged.
    """
    first = vehicle.inertia[0]
    inertia = first.diagonal()
    lag = float(torch.maximum(vehicle.time_constant_up[0], vehicle.time_constant_down[0]).max()) + dt
    quickest, damping = frequency_and_damping(lag, cfg.phase_margin)
    authority = (allocation.torque_authority(float(vehicle.mass[0]) * gravity) / inertia).clamp_min(0.0).sqrt()
    attitude = explicit_or_derived(cfg.attitude_frequency, authority.clamp_max(quickest))
    attitude_damping = explicit_or_derived(cfg.attitude_damping, torch.full_like(inertia, damping))
    if extra_lag > 0.0:
        attitude, attitude_damping = _slow_down_loop(
            attitude, attitude_damping, frequency_ratio_of_loop(cfg.phase_margin) * extra_lag
        )
    frequency = 0.0  # of a vehicle without control of roll or pitch
    if bool((attitude[:2] > 0.0).all()):
        attitude_lag = float((2.0 * attitude_damping[:2] / attitude[:2]).max())
        frequency, damping = frequency_and_damping(attitude_lag, cfg.phase_margin)
    position = explicit_or_derived(cfg.position_frequency, torch.full_like(inertia, frequency))
    position_damping = explicit_or_derived(cfg.position_damping, torch.full_like(inertia, damping))
    tilt = cfg.max_inclination
    return LeeGains(
        position=vehicle.rows_for_all_envs(position**2),
        velocity=vehicle.rows_for_all_envs(2.0 * position_damping * position),
        attitude=vehicle.rows_for_all_envs(inertia * attitude**2),
        rate=vehicle.rows_for_all_envs(2.0 * attitude_damping * attitude * inertia),
        mass=vehicle.mass,
        inertia=vehicle.inertia,
        gravity=gravity,
        max_yaw_rate=cfg.max_yaw_rate,
        max_inclination=derive_inclination(vehicle, allocation, gravity) if tilt is None else tilt,
    )


def _slow_down_loop(frequency: Tensor, damping: Tensor, lag: float) -> tuple[Tensor, Tensor]:
    """Return frequency and damping with the same rate gain, ``2 z w``, and a closed loop slower by ``lag`` [s]."""
    moves = frequency > 0.0
    rate = 2.0 * damping * frequency
    slower = (rate / (torch.where(moves, 2.0 * damping / torch.where(moves, frequency, 1.0), 1.0) + lag)).sqrt()
    return torch.where(moves, slower, 0.0), torch.where(moves, 0.5 * rate / torch.where(moves, slower, 1.0), damping)


def explicit_or_derived(numbers: tuple[float, ...] | None, derived: Tensor) -> Tensor:
    """Return given numbers as a tensor like the derived ones, or these."""
    return derived if numbers is None else derived.new_tensor(numbers)


def derive_inclination(vehicle: Vehicle, allocation: Allocation, gravity: float) -> float:
    """Return the tilt limit [rad]: there, thrust of weight plus half the surplus has the weight as its vertical part.

    Derived: ``cos tilt (1 + (F / (m g) - 1) / 2) = 1`` with the largest thrust F along body z.
    """
    weight = float(vehicle.mass[0]) * gravity
    if weight <= 0.0:
        return LARGEST_INCLINATION
    surplus = max(allocation.largest_thrust() / weight - 1.0, 0.0)
    return min(acos(1.0 / (1.0 + 0.5 * surplus)), LARGEST_INCLINATION)


def select_explicit_gains(cfg: ControllerCfg, control: ControlCfg) -> LeeGainsCfg | None:
    """Return the explicit gains of a controller, else of the robot; None for derived gains."""
    return cfg.gains if cfg.gains is not None else control.gains


def has_explicit_gains(cfg: ControllerCfg, control: ControlCfg) -> bool:
    """Return whether the controller or the robot gives any explicit gain."""
    if cfg.autopilot is not None:
        return select_autopilot(cfg, control).has_explicit_gains
    return select_explicit_gains(cfg, control) is not None


def select_autopilot(cfg: ControllerCfg, control: ControlCfg) -> Any:
    """Return the autopilot parameters of a controller, else those of the robot, with the controller's own rate."""
    assert cfg.autopilot is not None
    own, of_robot = getattr(cfg, cfg.autopilot), getattr(control, cfg.autopilot)
    if own.has_explicit_gains or of_robot is None:
        return own
    rate = getattr(own, "rate_hz", None)
    return of_robot if rate is None else replace(of_robot, rate_hz=rate)


def make_gains_with_timing(
    cfg: ControllerCfg, control: ControlCfg, vehicle: Vehicle, allocation: Allocation, *, gravity: float, timing: Timing
) -> LeeGains:
    """Return ``make_gains`` at the period of the inner level, with the delay between the levels."""
    dt, lag = timing.inner_period, timing.lag_between_levels
    return make_gains(cfg, control, vehicle, allocation, gravity=gravity, dt=dt, extra_lag=lag)


def make_gains(
    cfg: ControllerCfg, control: ControlCfg, vehicle: Vehicle, allocation: Allocation, *, gravity: float,
    dt: float | None, extra_lag: float = 0.0,
) -> LeeGains:  # fmt: skip
    """Return the explicit gains of a controller, or else ``derive_gains``.

    Raises:
        ConfigError: If derived gains lack a time step, or buoyancy carries the weight that the law needs.
    """
    gravity = apparent_gravity(control, float(vehicle.mass[0]), gravity)
    _require_weight(cfg.law, gravity)
    explicit = select_explicit_gains(cfg, control)
    if explicit is not None:
        return explicit_gains(explicit, vehicle, gravity)
    if dt is None:
        raise ConfigError(f"law {cfg.law!r}: gains are derived from the time step. Give dt [s]")
    return derive_gains(control, vehicle, allocation, gravity=gravity, dt=dt, extra_lag=extra_lag)


def apparent_gravity(control: ControlCfg, mass: float, gravity: float) -> float:
    """Return gravity less the declared buoyancy per mass [m/s²], which the rotors of a mass [kg] carry."""
    return gravity - control.buoyancy / mass


def _require_weight(law: str, gravity: float) -> None:
    """Raise ``ConfigError`` for a law that tilts its thrust if buoyancy carries the weight."""
    if law != "pose" and gravity < LEAST_GRAVITY:
        raise ConfigError(
            f"law {law!r}: moves sideways by tilting its thrust, but buoyancy leaves only {gravity:.3g} N per kg "
            f"(control: buoyancy) of {LEAST_GRAVITY:g} needed. Take rov_fully_actuated_control"
        )


def explicit_gains(cfg: LeeGainsCfg, vehicle: Vehicle, gravity: float) -> LeeGains:
    """Return the given gains, equal in all environments."""
    return LeeGains(
        **{name: vehicle.rows_for_all_envs(getattr(cfg, name)) for name in GAINS},
        mass=vehicle.mass,
        inertia=vehicle.inertia,
        gravity=gravity,
        max_yaw_rate=cfg.max_yaw_rate,
        max_inclination=cfg.max_inclination,
    )


def bind_gains(gains: LeeGains, vehicle: Vehicle) -> LeeGains:
    """Return gains on the device of their vehicle."""
    moved = {name: move_rows(getattr(gains, name), vehicle.mass.device) for name in GAINS}
    return replace(gains, **moved, mass=vehicle.mass, inertia=vehicle.inertia)


def gain_range(name: str, cfg: RandomizeCfg, declared: Tensor) -> tuple[Tensor, Tensor]:
    """Return the lowest and highest drawn values (E, 3) of a gain with one shared row, at least 0.

    Ranges with negative gains are refused elsewhere.
    """
    reached = cfg.value_limits(f"gains.{name}", declared[0].tolist(), spread=LARGEST_NORMAL)
    low, high = (declared.new_tensor(ends).clamp_min(0.0) for ends in zip(*reached, strict=True))
    return share_row(low, len(declared)), share_row(high, len(declared))


def gains_with_own_rows(gains: LeeGains) -> LeeGains:
    """Return gains with own writable rows of each environment, (E, 3)."""
    return replace(gains, **{name: own_rows(getattr(gains, name)) for name in GAINS})
