"""Response of a rotor's state, speed or thrust, to its command: lag, slew limit and dead band.

``dx/dt = clip((c - x) / tau, -S, S)`` with the state x, the command c, and separate time constants and slew rates for rising
and falling size of x. Pure functions of tensors. Letters: E environments, R rotors.
"""

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from aerial_gym.math.rows import choose
from aerial_gym.physics.rotors import SHORTEST, approach, lag_acceleration, lag_speed, select_by_direction
from aerial_gym.physics.vehicle import Vehicle

FASTEST = 1e30  # Slew rate that represents no limit: far above all others, with finite products in float32


@dataclass(frozen=True, kw_only=True)
class CommandSwitch:
    """Two successive commands of the rotors within a step."""

    earlier: Tensor  # First commands [rad/s] or [N], (E, R)
    later: Tensor  # Second ones, likewise
    change: Tensor  # Time of the second commands after the start of the step [s], (E, 1)


@dataclass(frozen=True, kw_only=True)
class LinearRotorSpeeds:
    """Rotor speeds that are linear within a step, as measured in a log, without lag."""

    rate: Tensor  # Rate of change of their states [rad/s²] or [N/s], (E, R)


RotorCommand = Tensor | CommandSwitch | LinearRotorSpeeds  # Constant (E, R), two successive ones, or measured speeds


def stop_in_dead_band(vehicle: Vehicle, command: Tensor) -> Tensor:
    """Set commands (E, R) within the dead band to zero."""
    if "dead_band" not in vehicle.traits:
        return command
    return torch.where(command.abs() < vehicle.dead_band, 0.0, command)


class RotorLag(Protocol):
    """Response of rotor states to constant commands. Its unit of time is that of all spans."""

    def follow(self, state: Tensor, command: Tensor, span: float | Tensor) -> Tensor:
        """Return the states after a span, (E, R)."""
        ...

    def rate(self, state: Tensor, command: Tensor, jump: Tensor, span: float | Tensor) -> Tensor:
        """Return the rates of change, (E, R); those of rotors without lag are ``jump / span``."""
        ...


@dataclass(frozen=True)
class FirstOrderLag:
    """First-order lag with time constants [s]."""

    tau_up: Tensor  # For a command above the state, (E, R); 0 follows at once
    tau_down: Tensor

    def follow(self, state: Tensor, command: Tensor, span: float | Tensor) -> Tensor:
        """Return ``rotors.lag_speed``."""
        return lag_speed(state, command, self.tau_up, self.tau_down, span)

    def rate(self, state: Tensor, command: Tensor, jump: Tensor, span: float | Tensor) -> Tensor:
        """Return ``rotors.lag_acceleration``."""
        return lag_acceleration(state, command, self.tau_up, self.tau_down, jump, span)


@dataclass(frozen=True)
class DecayLag:
    """First-order lag given by decays ``d = exp(-unit / tau)``; times are multiples of that unit.

    A kernel computes the decays once per launch, because a power with a known exponent costs less than an exponential.
    """

    decay_up: Tensor  # For a command above the state, (E, R); 0 follows at once
    decay_down: Tensor

    def follow(self, state: Tensor, command: Tensor, span: float | Tensor) -> Tensor:
        """Return ``c + (x - c) d^span``."""
        decay = select_by_direction(state, command, self.decay_up, self.decay_down)
        return approach(state, command, _decay_over_span(span, decay))

    def rate(self, state: Tensor, command: Tensor, jump: Tensor, span: float | Tensor) -> Tensor:
        """Return ``-log(d) (c - x)``, and without lag ``jump / span``."""
        decay = select_by_direction(state, command, self.decay_up, self.decay_down)
        lags = decay > 0.0
        return torch.where(lags, -torch.log(torch.where(lags, decay, 1.0)) * (command - state), jump / span)


def _decay_over_span(span: float | Tensor, decay: Tensor) -> Tensor:
    """Return ``decay**span`` for spans from 0.

    A kernel takes fewer registers for an exponential than for a power with a computed exponent.
    """
    if not isinstance(span, Tensor):
        return decay**span
    lags = decay > 0.0
    without_lag = torch.where(span > 0.0, 0.0, 1.0)
    return torch.where(lags, torch.exp(span * torch.log(torch.where(lags, decay, 1.0))), without_lag)


@dataclass(frozen=True)
class SlewLimitedLag:
    """First-order lag with a slew limit, for states of either sign."""

    tau_up: Tensor  # For a growing size of the state [s], (E, R)
    tau_down: Tensor
    slew_up: Tensor  # Largest rate of growth, (E, R); infinite for no limit
    slew_down: Tensor

    def follow(self, state: Tensor, command: Tensor, span: float | Tensor) -> Tensor:
        """Return ``slew_limited_lag``."""
        return slew_limited_lag(state, command, self.tau_up, self.tau_down, self.slew_up, self.slew_down, span)

    def rate(self, state: Tensor, command: Tensor, jump: Tensor, span: float | Tensor) -> Tensor:
        """Return ``slew_limited_rate``."""
        return slew_limited_rate(state, command, self.tau_up, self.tau_down, self.slew_up, self.slew_down, jump, span)


def vehicle_lag(vehicle: Vehicle) -> RotorLag:
    """Return the lag of a vehicle's rotors."""
    tau = vehicle.time_constant_up, vehicle.time_constant_down
    if vehicle.traits & {"reversible", "slew"}:
        return SlewLimitedLag(*tau, vehicle.slew_rate, vehicle.slew_rate_down)
    return FirstOrderLag(*tau)


def follow_command(lag: RotorLag, state: Tensor, command: RotorCommand, dt: float | Tensor) -> Tensor:
    """Return the exact states of the rotors, (E, R), ``dt`` [s] after the start of a step."""
    if isinstance(command, LinearRotorSpeeds):
        return state + command.rate * dt
    if isinstance(command, Tensor):
        return lag.follow(state, command, dt)
    early = command.change.clamp_max(dt)
    return lag.follow(lag.follow(state, command.earlier, early), command.later, dt - early)


def stage_rates(
    lag: RotorLag, stages: tuple[Tensor, Tensor, Tensor], command: RotorCommand, dt: float | Tensor
) -> tuple[Tensor, ...]:
    """Return the rates of change of the states, (E, R), at the start, in the middle and at the end of a step of ``dt`` [s].

    If the command changes within the step, all rates are shifted alike, so that Simpson's rule gives the exact change of the
    states, hence of the rotors' momentum.
    """
    if isinstance(command, LinearRotorSpeeds):
        return command.rate, command.rate, command.rate
    start, _, end = stages
    if isinstance(command, Tensor):
        return tuple(lag.rate(state, command, command - start, dt) for state in stages)
    rates = []
    for state, time in zip(stages, (0.0, 0.5 * dt, dt), strict=True):
        now = torch.where(command.change > time, command.earlier, command.later)
        rates.append(lag.rate(state, now, end - start, dt))
    missing = (end - start) / dt - (rates[0] + 4.0 * rates[1] + rates[2]) / 6.0
    return tuple(rate + missing for rate in rates)


def slew_limited_rate(
    state: Tensor, command: Tensor, tau_up: Tensor, tau_down: Tensor, slew_up: Tensor, slew_down: Tensor, jump: Tensor,
    dt: float | Tensor,
) -> Tensor:  # fmt: skip
    """Return ``clip((c - x) / tau, -S, S)``, (E, R), and without lag ``jump / dt`` in place of the quotient."""
    falls = state * (command - state) < 0.0
    tau, slew = torch.where(falls, tau_down, tau_up), torch.where(falls, slew_down, slew_up)
    lags = tau > 0.0
    rate = torch.where(lags, (command - state) / torch.where(lags, tau, 1.0), jump / dt)
    return torch.maximum(torch.minimum(rate, slew), -slew)


def slew_limited_lag(
    state: Tensor, command: Tensor, tau_up: Tensor, tau_down: Tensor, slew_up: Tensor, slew_down: Tensor,
    dt: float | Tensor,
) -> Tensor:  # fmt: skip
    """Return the state after ``dt`` under a constant command with lag and slew limit, exact for any division of the span.

    The distance to the command shrinks at the slew rate S down to ``S tau``, then by ``exp(-t / tau)``. A state that passes
    zero first falls in size, then grows, each with its own time constant and slew rate.

    Args:
        state: Speeds [rad/s] or thrusts [N], of either sign, (E, R).
        command: Commanded ones, (E, R).
        tau_up: Time constant for a growing size of the state [s], (E, R). Zero follows at the slew rate.
        tau_down: Time constant for a falling size [s], (E, R).
        slew_up: Largest rate of growth, (E, R); infinite for no limit.
        slew_down: Largest rate of fall, (E, R), likewise.
        dt: Span [s], scalar or (E, 1).

    Returns:
        States, (E, R).

    Source:
        Derived: ``dx/dt = clip((c - x) / tau, -S, S)`` integrated piece by piece; the rate is S while ``|c - x| > S tau``.
    """
    tau_up, tau_down = tau_up.clamp_min(SHORTEST), tau_down.clamp_min(SHORTEST)
    slew_up, slew_down = slew_up.clamp_max(FASTEST), slew_down.clamp_max(FASTEST)
    way, distance = torch.sign(command - state), (command - state).abs()
    falls = state * way < 0.0
    crosses = falls & (command * way > 0.0)
    beyond = torch.where(crosses, command.abs(), 1.0)
    span = torch.zeros_like(distance) + dt  # of their float type, which a bare number would not have
    until_zero = choose(
        crosses,
        _time_to_distance,
        torch.where(falls, span, 0.0),
        torch.where(crosses, distance, 1.0),
        beyond,
        tau_down,
        slew_down,
    )
    falling = torch.minimum(until_zero, span).clamp_min(0.0)  # a rounded quotient may make it negative
    distance = _distance_left(distance, tau_down, slew_down, falling)
    return command - way * _distance_left(distance, tau_up, slew_up, span - falling)


def _distance_left(distance: Tensor, tau: Tensor, slew: Tensor, span: Tensor) -> Tensor:
    """Return the remaining part of a distance >= 0 after a span [s]."""
    linear = torch.minimum(slew * span, (distance - slew * tau).clamp_min(0.0))
    return (distance - linear) * torch.exp(-(span - linear / slew).clamp_min(0.0) / tau)


def _time_to_distance(distance: Tensor, less: Tensor, tau: Tensor, slew: Tensor) -> Tensor:
    """Return the time [s] in which a distance shrinks to ``less`` > 0."""
    linear = torch.minimum((distance - slew * tau).clamp_min(0.0), distance - less)
    return linear / slew + tau * torch.log((distance - linear) / less)
