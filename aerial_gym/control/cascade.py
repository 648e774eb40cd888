"""Controllers with memory: a law over a rate loop, each at its own rate, with delays between them.

A law of ``control.lee`` gets unit rate gain and no inertia, so that its torque is the error of its body-rate setpoint. Without
a rate loop the law commands torque itself; only its own rate and the delay of the action are new.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors, U entries of an action, M numbers of memory.
"""

from dataclasses import dataclass, replace
from functools import partial
from math import exp, pi

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg, RateLoopCfg
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.gains import (
    GAINS,
    explicit_or_derived,
    frequency_ratio_of_loop,
    gains_with_own_rows,
    make_gains_with_timing,
)
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import LeeGains, thrust_wrench
from aerial_gym.control.stateful import StatefulController
from aerial_gym.control.timing import make_timing
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle, own_rows, share_row

INTEGRAL_SHARE = 0.5  # Default limit of the integral, as a share of the torque available at hover


@dataclass(frozen=True, kw_only=True)
class RateGains:
    """Gains of a rate loop."""

    proportional: Tensor  # [1/s], (E, 3)
    integral: Tensor  # [1/s²], (E, 3)
    integral_limit: Tensor  # [rad/s²], (E, 3)
    derivative: Tensor  # [-], (E, 3)
    smoothing: Tensor  # Low-pass coefficient of one run, `1 - exp(-2 pi f dt)`, (E, 1)


def rate_gains(
    cfg: RateLoopCfg, base: LeeGains, vehicle: Vehicle, allocation: Allocation, *, phase_margin: float, dt: float
) -> RateGains:
    """Return the gains of a rate loop that runs every ``dt`` [s]; missing ones follow from the law's own.

    The proportional gain is the law's on the rate over the inertia. The integral is slower than it by a², with the a of
    ``control.gains``: at the crossover of the attitude loop it costs ``atan 1/a²`` of phase.
    """
    inertia, row = vehicle.inertia[0].diagonal(), partial(share_row, num_envs=vehicle.num_envs)
    authority = allocation.torque_authority(float(vehicle.mass[0]) * base.gravity) / inertia
    proportional = explicit_or_derived(cfg.proportional, base.rate[0] / inertia)
    return RateGains(
        proportional=row(proportional),
        integral=row(explicit_or_derived(cfg.integral, (proportional / frequency_ratio_of_loop(phase_margin)) ** 2)),
        integral_limit=row(explicit_or_derived(cfg.integral_limit, INTEGRAL_SHARE * authority)),
        derivative=row(inertia.new_tensor(cfg.derivative)),
        smoothing=vehicle.rows_for_all_envs(
            [1.0 if cfg.cutoff_hz is None else 1.0 - exp(-2.0 * pi * cfg.cutoff_hz * dt)]
        ),
    )


def gains_for_rate_setpoint(base: LeeGains) -> LeeGains:
    """Return the gains that turn a law's torque into the error of its body-rate setpoint [rad/s]."""
    rate, num_envs = base.rate[0], len(base.rate)
    moves = rate > 0.0
    attitude = torch.where(moves, base.attitude[0] / torch.where(moves, rate, 1.0), 0.0)
    rows = {"attitude": attitude, "rate": torch.ones_like(rate), "inertia": torch.zeros_like(base.inertia[0])}
    return replace(base, **{name: share_row(row, num_envs) for name, row in rows.items()})


LOOP_NUMBERS = 9  # Memory of a rate loop: integral (3), derivative (3), angular velocity of the previous run (3)


class CascadeController(StatefulController):
    """A law of ``control.laws`` with memory, over a rate loop or alone."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot settings."""
        self._law, loop, timing = LAWS[cfg.law], cfg.rate_loop, make_timing(cfg, dt)
        self.action_names = self._law.action
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        base = make_gains_with_timing(cfg, control, vehicle, self.allocation, gravity=gravity, timing=timing)
        self._inertia = vehicle.inertia
        self.gains = base if loop is None else gains_for_rate_setpoint(base)
        self.rate_gains: RateGains | None = None
        if loop is not None:
            margin, span = control.phase_margin, timing.inner_period
            self.rate_gains = rate_gains(loop, base, vehicle, self.allocation, phase_margin=margin, dt=span)
        inner = 0 if loop is None else LOOP_NUMBERS
        num_setpoint = None if loop is None else 4
        self.set_needs(timing, num_rotors=vehicle.num_rotors, inner=inner, num_setpoint=num_setpoint)

    @property
    def hover_setpoint(self) -> Tensor:
        """Weight [N] and no body rates; with a rate loop."""
        setpoint = super().hover_setpoint
        setpoint[0] = self.gains.mass[0] * self.gains.gravity
        return setpoint

    def outer(self, state: BodyState, action: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return thrust [N] and body-rate setpoint [rad/s], (E, 4); without a rate loop, the action."""
        if self.rate_gains is None:
            return action, memory
        wrench = self._law.wrench(state, action, self.gains)
        return torch.cat((wrench[:, 2:3], wrench[:, 3:] + state.ang_vel), dim=-1), memory

    def inner(self, state: BodyState, setpoint: Tensor, memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return rotor speeds (E, R) of the rate loop; without one, of the law for an action."""
        gains, ang_vel = self.rate_gains, state.ang_vel
        if gains is None:
            return self.allocation.speed_for_wrench(self._law.wrench(state, setpoint, self.gains)), memory
        integral, slope, before = memory.split(3, dim=-1)
        span = self.timing.inner_period
        measured = torch.where(begins, 0.0, (ang_vel - before) / span)
        slope = slope + gains.smoothing * (measured - slope)
        error = setpoint[:, 1:] - ang_vel
        wanted = gains.proportional * error + integral - gains.derivative * slope
        torque = (self._inertia * wanted.unsqueeze(1)).sum(-1)
        torque = torque + torch.linalg.cross(ang_vel, (self._inertia * ang_vel.unsqueeze(1)).sum(-1))
        allotted = self.allocation.allot(thrust_wrench(setpoint[:, 0], torque))
        given = torch.cat((allotted.turn, allotted.turn, allotted.rest), dim=-1)
        grows = (given >= 1.0) | (error * wanted <= 0.0)  # stops while the rotors saturate
        integral = integral + torch.where(grows, gains.integral * span * error, 0.0)
        integral = integral.clamp(-gains.integral_limit, gains.integral_limit)
        return self.allocation.speed_within_limits(allotted.thrust), torch.cat((integral, slope, ang_vel), dim=-1)

    @property
    def gains_by_name(self) -> dict[str, Tensor]:
        """Gains of the law; over a rate loop the attitude gain is body rate per error [1/s], and there is no rate gain."""
        names = GAINS if self.rate_gains is None else GAINS[:-1]
        return {name: getattr(self.gains, name) for name in names}

    def own_gains(self) -> None:
        """Give each environment its own writable rows (E, 3); call it before a backend takes the controller."""
        self.gains = gains_with_own_rows(self.gains)
        if self.rate_gains is not None:
            rows = {name: own_rows(rows) for name, rows in vars(self.rate_gains).items()}
            self.rate_gains = replace(self.rate_gains, **rows)
