"""Controllers with memory: a law over a rate loop, each at its own rate, with delays between them.

A law of ``control.lee`` gets unit rate gain and no inertia, so that its torque is the error of its body-rate setpoint. Without
a rate loop the law commands torque itself; only its own rate and the delay of the action are new.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors, U entries of an action, S slots of a ring,
M remembered numbers, P numbers on their way.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from math import exp, pi

import torch
from torch import Tensor

from aerial_gym.config.controller import ControlCfg, ControllerCfg, RateLoopCfg
from aerial_gym.control import cascade_fused, lee_fused
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.gains import GAINS, loop_spacing, make_gains, with_own_rows
from aerial_gym.control.laws import LAWS
from aerial_gym.control.lee import LeeGains, thrust_wrench
from aerial_gym.control.stateful import StatefulController, make_layout
from aerial_gym.control.timing import make_timing
from aerial_gym.physics.fused.law import FusedLaw
from aerial_gym.physics.law_memory import LawMemory
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle, own_rows, share_row

INTEGRAL_SHARE = 0.5
"""Default limit of the integral, as a share of the torque available at hover; the rest remains for manoeuvres."""


@dataclass(frozen=True, kw_only=True)
class RateGains:
    """Gains of a rate loop."""

    proportional: Tensor  # [1/s], (E, 3)
    integral: Tensor  # [1/s²], (E, 3)
    integral_limit: Tensor  # [rad/s²], (E, 3)
    derivative: Tensor  # [-], (E, 3)
    smoothing: float  # Low-pass coefficient of one run, `1 - exp(-2 pi f dt)`


def rate_gains(
    cfg: RateLoopCfg, base: LeeGains, vehicle: Vehicle, allocation: Allocation, *, phase_margin: float, dt: float
) -> RateGains:
    """Return the gains of a rate loop that runs every ``dt`` [s]; missing ones follow from the law's own.

    The proportional gain is the law's on the rate over the inertia. The integral is slower than it by a², with the a of
    ``control.gains``: at the crossover of the attitude loop it costs ``atan 1/a²`` of phase.
    """
    inertia, row = vehicle.inertia[0].diagonal(), partial(share_row, num_envs=vehicle.num_envs)
    authority = allocation.torque_authority(float(vehicle.mass[0]) * base.gravity) / inertia
    proportional = _explicit_or_derived(cfg.proportional, base.rate[0] / inertia)
    return RateGains(
        proportional=row(proportional),
        integral=row(_explicit_or_derived(cfg.integral, (proportional / loop_spacing(phase_margin)) ** 2)),
        integral_limit=row(_explicit_or_derived(cfg.integral_limit, INTEGRAL_SHARE * authority)),
        derivative=row(inertia.new_tensor(cfg.derivative)),
        smoothing=1.0 if cfg.cutoff_hz is None else 1.0 - exp(-2.0 * pi * cfg.cutoff_hz * dt),
    )


def _explicit_or_derived(numbers: tuple[float, ...] | None, derived: Tensor) -> Tensor:
    return derived if numbers is None else derived.new_tensor(numbers)


def setpoint_gains(base: LeeGains) -> LeeGains:
    """Return the gains that turn a law's torque into the error of its body-rate setpoint [rad/s]."""
    moves = base.rate > 0.0
    attitude = torch.where(moves, base.attitude / torch.where(moves, base.rate, 1.0), 0.0)
    return replace(base, attitude=attitude, rate=torch.ones_like(base.rate), inertia=torch.zeros_like(base.inertia))


OWN_NUMBERS = 9
"""Memory of a rate loop: integral (3), derivative (3), angular velocity of the previous run (3)."""


class CascadeController(StatefulController):
    """A law with memory; ``command`` is one physics step of it."""

    def __init__(self, cfg: ControllerCfg, vehicle: Vehicle, gravity: float, *, dt: float, control: ControlCfg) -> None:
        """Derive the gains from configuration, declared vehicle, gravity [m/s²], physics step [s] and robot settings."""
        law, loop = LAWS[cfg.law], cfg.rate_loop
        self.timing = timing = make_timing(cfg, dt)
        self.action_names, self._law = law.action, law
        self.allocation = Allocation(vehicle, gravity, saturation=cfg.allocation, effectiveness=control.effectiveness)
        base = make_gains(
            cfg, control, vehicle, self.allocation, gravity=gravity, dt=timing.loop * dt, extra_lag=timing.extra_lag
        )
        self._inertia = vehicle.inertia
        self.gains = base if loop is None else setpoint_gains(base)
        self.rate_gains: RateGains | None = None
        if loop is not None:
            margin, span = control.phase_margin, timing.loop * dt
            self.rate_gains = rate_gains(loop, base, vehicle, self.allocation, phase_margin=margin, dt=span)
        self._layout = make_layout(
            timing,
            own=OWN_NUMBERS if loop is not None else 0,
            num_rotors=vehicle.num_rotors,
            num_actions=len(law.action),
        )

    @property
    def _hover_setpoint(self) -> Tensor:
        return self.gains.mass[0] * self.gains.gravity

    def _run(self, state: BodyState, action: Tensor, memory: LawMemory, sent: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        wanted, gains = self._law.wrench(state, action, self.gains), self.rate_gains
        if gains is None:
            return self.allocation.speed_for_wrench(wanted), memory.numbers[:, :0], sent
        setpoint = torch.cat((wanted[:, 2:3], wanted[:, 3:] + state.ang_vel), dim=-1)
        setpoint, sent = self._delay_setpoint(setpoint, sent, memory.since)
        return *self._run_loop(gains, state.ang_vel, setpoint, memory), sent

    def _run_loop(
        self, gains: RateGains, ang_vel: Tensor, setpoint: Tensor, memory: LawMemory
    ) -> tuple[Tensor, Tensor]:
        """Return rotor speeds (E, R) and the new memory after one run of the rate loop."""
        integral, slope, before = memory.numbers[:, :9].split(3, dim=-1)
        span = self.timing.loop * self.timing.dt
        begins = (memory.since == 0).unsqueeze(-1)
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
        integral = torch.minimum(torch.maximum(integral, -gains.integral_limit), gains.integral_limit)
        return self.allocation.speed(allotted.thrust), torch.cat((integral, slope, ang_vel), dim=-1)

    @property
    def gains_by_name(self) -> dict[str, Tensor]:
        """Gains of the law; over a rate loop the attitude gain is body rate per error [1/s], and there is no rate gain."""
        names = GAINS if self.rate_gains is None else GAINS[:-1]
        return {name: getattr(self.gains, name) for name in names}

    def own_gains(self) -> None:
        """Give each environment its own writable rows (E, 3); call it before ``fused``."""
        self.gains = with_own_rows(self.gains)
        if self.rate_gains is not None:
            rows = {name: own_rows(rows) for name, rows in vars(self.rate_gains).items() if isinstance(rows, Tensor)}
            self.rate_gains = replace(self.rate_gains, **rows)

    def fused(self) -> FusedLaw | None:
        """Return the Warp version of the law."""
        if self._law.fused is None:
            return None
        has_loop = self.rate_gains is not None
        return self._fused(
            make_stateful_step=cascade_fused.maker(self._law, self.timing, self._layout, has_loop=has_loop),
            gains_type=cascade_fused.CascadeGains if has_loop else lee_fused.LeeParams,
            gains=self._fused_gains(),
        )

    def _fused_gains(self) -> Mapping[str, Tensor]:
        rows = lee_fused.gain_rows(self.gains)
        if self.rate_gains is None:
            return rows
        of_law = {f"lee.{name}": value for name, value in rows.items()}
        loop = {name: value for name, value in vars(self.rate_gains).items() if isinstance(value, Tensor)}
        smoothing = share_row(self.gains.mass.new_tensor(self.rate_gains.smoothing), self._inertia.shape[0])
        return of_law | loop | {"smoothing": smoothing, "body_inertia": self._inertia}
