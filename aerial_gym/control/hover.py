"""Where vehicles under a law hover, and how they get there: the rest of the closed loop, and its response to a start.

A law without an integrator answers a constant force or torque that it does not know of with an error: the vehicle rests beside
its setpoint. Newton's method on the map of a period finds that rest; the loop linearised there gives the flight towards it.
Letters: B vehicles under one law, R rotors, U entries of an action, X numbers of the state vector.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf

import torch
from torch import Tensor

from aerial_gym.control.linear_loop import BODY, LinearLoop, SampledLoop
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.torch_backend import TorchBackend

HOVER_SPAN = 10.0
"""Of a flight at hover [s]."""

HOVER_RANGE = 0.1
"""Distance from its setpoint within which a vehicle hovers [m]."""

DISTURBANCE = (0.1, 0.1, 0.2, 0.2)
"""Distance [m], turn [rad], speed [m/s] and rate [rad/s] of a flown start from hover, along each axis. Source: speed and rate
are those that ``InitialStateCfg`` draws by default."""

NUM_STARTS = 4
"""Flown side by side: other corners of a cube for each quantity."""

LOOK = 0.05
"""Time between two looks at a flight [s]."""

LAST = 1.0
"""Span at the end of a flight in which it must be at hover [s]."""

QUIET = 0.1
"""Share of ``DISTURBANCE`` that meets no limit of the rotors."""

LOST = 2.0
"""Distance [m] at which a flight is given up: several times the way of one that comes back from ``DISTURBANCE``."""

SAMPLES = 40
"""Moments of that flight."""

ITERATIONS = 12
"""Of Newton's method."""

SETTLED = 1e-5
"""Last change of Newton's method: in the units of ``AXES``, of rotors and memory as a share of their size."""

LARGEST_TURN = 0.3
"""Of one iteration [rad]: beyond it the loop is not linear."""

DEPENDENT = 1e-12
"""Singular value, as a share of the largest, of directions in which a loop is at rest anywhere."""


@dataclass(frozen=True, kw_only=True)
class Rest:
    """The states at which closed loops come to rest, if they do, and the loops about them."""

    start: Tensor  # First states, (B, X): the rest of a vehicle that flies as its law expects
    state: Tensor  # Of rest, (B, X); those of the start where there is none
    converged: Tensor  # Whether there is one, bool (B,): none if a law demands too much thrust or tilt
    loop: LinearLoop  # Linearised there

    @property
    def offset(self) -> Tensor:
        """Body origin from its start [m], world, (B, 3)."""
        return (self.state - self.start)[:, :3]

    @property
    def drift(self) -> Tensor:
        """Velocity [m/s], world, (B, 3): 0 of a law that holds a place."""
        return self.state[:, 6:9]


def find_rest(loop: SampledLoop, start: Tensor, action: Tensor, kept: Sequence[int]) -> Rest:
    """Return the rest of loops, from starts (B, X) on, under an action (U,).

    Args:
        kept: Numbers of the state vector that the law brings to rest; others stay as they are.
    """
    state, about = start, loop.linearised(start, action)
    for _ in range(ITERATIONS):
        step = _newton_step(about, kept)
        size = torch.cat((torch.ones_like(step[:, :BODY]), state[:, BODY:].abs().clamp_min(1.0)), -1)
        converged = (step.abs() / size).amax(-1) < SETTLED  # NaN is not
        step = step * (LARGEST_TURN / step[:, 3:6].abs().amax(-1, keepdim=True).clamp_min(LARGEST_TURN))
        state = torch.where(step.isfinite().all(-1, keepdim=True), state + step, state)
        if bool(converged.all()):
            return Rest(start=start, state=state, converged=converged, loop=about)
        about = loop.linearised(state, action)
    state = torch.where(converged.unsqueeze(-1), state, start)
    return Rest(start=start, state=state, converged=converged, loop=loop.linearised(state, action))


def _newton_step(loop: LinearLoop, kept: Sequence[int]) -> Tensor:
    """Return the changes of the states (B, X) after which a period changes nothing, of least size where there are several."""
    mapped = loop.period_map(late=False)
    change, rows = mapped[:, :-1, -1], torch.tensor(kept)
    slopes = mapped[:, rows][:, :, rows]
    inverse = torch.linalg.pinv(torch.eye(len(kept), dtype=slopes.dtype) - slopes, rtol=DEPENDENT)
    step = torch.zeros_like(change)
    step[:, rows] = (inverse @ change[:, rows].unsqueeze(-1)).squeeze(-1)
    return step


def distances(rest: Rest, *, rotors: Tensor, dt: float) -> Tensor:
    """Return the distances [m] of the body origins from their starts at moments of ``HOVER_SPAN``, (SAMPLES, B), linearised.

    Args:
        rotors: Their states at the start, which they keep until the first command has come, (R,).
        dt: Physics step [s].
    """
    loop, begin = rest.loop, rest.start - rest.state
    sent = ((rotors - loop.told) @ loop.basis).repeat(1, loop.slots)
    deviation = torch.cat((begin, sent, torch.ones_like(begin[:, :1])), dim=-1).unsqueeze(-1)
    periods = max(1, ceil(HOVER_SPAN / SAMPLES / (len(loop.steps) * dt)))
    leap, history = torch.linalg.matrix_power(loop.period_map(), periods), []
    for _ in range(SAMPLES):
        deviation = leap @ deviation
        history.append((deviation[:, :3, 0] - begin[:, :3]).norm(dim=-1))
    return torch.stack(history).nan_to_num(nan=inf)


def flown_distance(loop: SampledLoop, rest: Rest, action: Tensor, *, returns: bool, decays: bool) -> float:
    """Return the largest distance [m] from rest at the end of ``NUM_STARTS`` flights of ``HOVER_SPAN``, limits and all.

    Args:
        loop: Vehicles and law; the first one flies.
        rest: Of the loop; the flights begin about its start.
        action: Told to the law, (U,).
        returns: Whether the law holds a place; else the distance counts from where a flight is ``LAST`` before its end.
        decays: Whether small disturbances are known to decay: flights then end where what is left is ``QUIET``.
    """
    backend, signs = TorchBackend(), action.new_tensor([(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)])
    begin = rest.start[0].repeat(NUM_STARTS, 1)
    for i, size in enumerate(DISTURBANCE):
        begin[:, 3 * i : 3 * i + 3] += size * signs.roll(i, 0)
    state, told = loop.fly_in(backend, begin), action.expand(NUM_STARTS, -1)
    steps, home, farthest = max(1, round(LOOK / loop.dt)), rest.state[0, :3].repeat(NUM_STARTS, 1), 0.0
    looks, last = ceil(HOVER_SPAN / (steps * loop.dt)), ceil(LAST / (steps * loop.dt))
    for look in range(looks):
        backend.step(state, told, loop.dt, steps)
        distance = float((state.position - home).norm(dim=-1).nan_to_num(nan=inf).max())
        if distance > LOST:
            return distance
        if decays and _left(state, home if returns else state.position) < QUIET:
            return distance if returns else 0.0
        if look > looks - last:
            farthest = max(farthest, distance)
        elif look == looks - last and not returns:
            home = state.position.clone()
    return farthest


def _left(state: BodyState, home: Tensor) -> float:
    """Return the largest distance from home, speed and rate of flights, as a share of ``DISTURBANCE``."""
    parts = (state.position - home, state.lin_vel, state.ang_vel)
    sizes = (DISTURBANCE[0], *DISTURBANCE[2:])
    return max(float(part.abs().max()) / size for part, size in zip(parts, sizes, strict=True))
