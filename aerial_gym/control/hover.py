"""Hover of vehicles under a control law: the equilibrium of the closed loop, and the response to a start beside it.

A law without integrator has a steady error under an unknown constant force or torque: the vehicle hovers beside its setpoint.
Newton's method on the map of a period finds this equilibrium (rest); the loop linearised there gives the flight towards it.
Laws of the package state the axes that they control at hover in ``control.laws``. A law of another package states them in the
class attribute ``trim``, and its action at hover, unless that is zeros, in ``hover_action``.
Letters: B vehicles under one law, R rotors, U entries of an action, X numbers of the state vector.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, inf

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.control.catalog import CONTROL_LAWS
from aerial_gym.control.controllers import Controller
from aerial_gym.control.laws import LAWS
from aerial_gym.control.linear_loop import AXES, BODY, DiscreteLoop, LinearLoop
from aerial_gym.errors import ConfigError
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.torch_backend import TorchBackend

HOVER_SPAN = 10.0  # Duration of a flight at hover [s]
HOVER_RANGE = 0.1  # Largest distance from the setpoint that counts as hover [m]

DISTURBANCE = (0.1, 0.1, 0.2, 0.2)
"""Initial deviation of a flight from hover along each axis: position [m], attitude [rad], speed [m/s] and rate [rad/s].
Source: speed and rate are the default ranges of ``InitialStateCfg``."""

NUM_STARTS = 4  # Number of flights in a batch, from different corners of a cube for each quantity
LOOK = 0.05  # Time between two checks of a flight [s]
LAST = 1.0  # Final part of a flight that must be at hover [s]
QUIET = 0.1  # Share of `DISTURBANCE` that saturates no rotor
LOST = 2.0  # Distance [m] at which a flight counts as lost: several times that of flights that return
SAMPLES = 40  # Number of times in the linear response
ITERATIONS = 12  # Largest number of Newton iterations
SETTLED = 1e-5  # Convergence limit of Newton's change: in the units of `AXES`, relative for rotors and memory
LARGEST_TURN = 0.3  # Largest rotation of one iteration [rad]; beyond it the loop is not linear
DEPENDENT = 1e-12  # Relative singular value of directions in which every state is an equilibrium


@dataclass(frozen=True, kw_only=True)
class HoverEquilibria:
    """Equilibria of closed loops, and the loops linearised there."""

    start: Tensor  # First states, (B, X): the rest of a vehicle that flies as its law expects
    state: Tensor  # Equilibrium, (B, X); the start without one
    converged: Tensor  # Whether an equilibrium exists, bool (B,): none does beyond the limits of thrust or tilt
    loop: LinearLoop  # Loop linearised at the equilibrium

    @property
    def offset_from_start(self) -> Tensor:
        """Offset of the body origin from its start [m], world, (B, 3)."""
        return (self.state - self.start)[:, :3]

    @property
    def drift_velocity(self) -> Tensor:
        """Velocity [m/s], world, (B, 3): 0 for position control."""
        return self.state[:, 6:9]


def find_equilibrium(loop: DiscreteLoop, start: Tensor, action: Tensor, kept: Sequence[int]) -> HoverEquilibria:
    """Find the equilibrium of loops from starts (B, X) under an action (U,), by Newton's method.

    Args:
        kept: Indices of controlled states; all others stay constant.
    """
    state, about = start, loop.linearise(start, action)
    for _ in range(ITERATIONS):
        step = _newton_step(about, kept)
        size = torch.cat((torch.ones_like(step[:, :BODY]), state[:, BODY:].abs().clamp_min(1.0)), -1)
        converged = (step.abs() / size).amax(-1) < SETTLED  # NaN is not
        step = step * (LARGEST_TURN / step[:, 3:6].abs().amax(-1, keepdim=True).clamp_min(LARGEST_TURN))
        state = torch.where(step.isfinite().all(-1, keepdim=True), state + step, state)
        if bool(converged.all()):
            return HoverEquilibria(start=start, state=state, converged=converged, loop=about)
        about = loop.linearise(state, action)
    state = torch.where(converged.unsqueeze(-1), state, start)
    return HoverEquilibria(start=start, state=state, converged=converged, loop=loop.linearise(state, action))


def _newton_step(loop: LinearLoop, kept: Sequence[int]) -> Tensor:
    """Return Newton's change of the states (B, X), of least norm if there are several."""
    mapped = loop.period_map(late=False)
    change, rows = mapped[:, :-1, -1], torch.tensor(kept)
    slopes = mapped[:, rows][:, :, rows]
    inverse = torch.linalg.pinv(torch.eye(len(kept), dtype=slopes.dtype) - slopes, rtol=DEPENDENT)
    step = torch.zeros_like(change)
    step[:, rows] = (inverse @ change[:, rows].unsqueeze(-1)).squeeze(-1)
    return step


def distances_from_start(rest: HoverEquilibria, *, rotors: Tensor, dt: float) -> Tensor:
    """Return the distances [m] of the body origins from their starts over ``HOVER_SPAN``, (SAMPLES, B), in the linear loop.

    Args:
        rotors: Their states at the start, constant until the first command arrives, (R,).
    """
    loop, begin = rest.loop, rest.start - rest.state
    sent = ((rotors - loop.command) @ loop.rotor_combinations).repeat(1, loop.slots)
    deviation = torch.cat((begin, sent, torch.ones_like(begin[:, :1])), dim=-1).unsqueeze(-1)
    periods = max(1, ceil(HOVER_SPAN / SAMPLES / (len(loop.steps) * dt)))
    leap, history = torch.linalg.matrix_power(loop.period_map(), periods), []
    for _ in range(SAMPLES):
        deviation = leap @ deviation
        history.append((deviation[:, :3, 0] - begin[:, :3]).norm(dim=-1))
    return torch.stack(history).nan_to_num(nan=inf)


def largest_final_distance(
    loop: DiscreteLoop, rest: HoverEquilibria, action: Tensor, *, returns: bool, decays: bool
) -> float:
    """Return the largest final distance [m] from rest of ``NUM_STARTS`` nonlinear flights of ``HOVER_SPAN``.

    Args:
        loop: Vehicles and law; the first one flies.
        rest: Equilibrium of the loop; the flights begin about its start.
        action: Action of the law, (U,).
        returns: Whether the law holds a position; else distances count from the position ``LAST`` before the end.
        decays: Whether small disturbances decay; then flights end once the deviation is below ``QUIET``.
    """
    backend, signs = TorchBackend(), action.new_tensor([(1, 1, 1), (-1, 1, -1), (1, -1, -1), (-1, -1, 1)])
    begin = rest.start[0].repeat(NUM_STARTS, 1)
    for i, size in enumerate(DISTURBANCE):
        begin[:, 3 * i : 3 * i + 3] += size * signs.roll(i, 0)
    state, actions = loop.prepare_flight(backend, begin), action.expand(NUM_STARTS, -1)
    steps, home, farthest = max(1, round(LOOK / loop.dt)), rest.state[0, :3].repeat(NUM_STARTS, 1), 0.0
    looks, last = ceil(HOVER_SPAN / (steps * loop.dt)), ceil(LAST / (steps * loop.dt))
    for look in range(looks):
        backend.step(state, actions, loop.dt, steps)
        distance = float((state.position - home).norm(dim=-1).nan_to_num(nan=inf).max())
        if distance > LOST:
            return distance
        if decays and _deviation_per_disturbance(state, home if returns else state.position) < QUIET:
            return distance if returns else 0.0
        if look > looks - last:
            farthest = max(farthest, distance)
        elif look == looks - last and not returns:
            home = state.position.clone()
    return farthest


def _deviation_per_disturbance(state: BodyState, home: Tensor) -> float:
    """Return the largest deviation of flights in position, speed and rate, as a share of ``DISTURBANCE``."""
    parts = (state.position - home, state.lin_vel, state.ang_vel)
    sizes = (DISTURBANCE[0], *DISTURBANCE[2:])
    return max(float(part.abs().max()) / size for part, size in zip(parts, sizes, strict=True))


HEIGHT_ENTRY = "z [m]"  # Name of the entry of an action that is a height


def trim_axes(controller: ControllerCfg) -> tuple[str, ...] | None:
    """Return the ``AXES`` that a law controls; None for a law of another package that does not state them.

    Raises:
        ConfigError: If a name is unknown.
    """
    if controller.law in LAWS:
        return tuple(LAWS[controller.law].trim.split())
    if controller.law not in CONTROL_LAWS:
        return ()
    entry = CONTROL_LAWS.get(controller.law)
    trim = getattr(getattr(entry, "func", entry), "trim", None)  # a functools.partial has the class in func
    if trim is None:
        return None
    if unknown := set(trim.split()) - set(AXES):
        raise ConfigError(
            f"law {controller.law!r}: trim = {trim!r}: {min(unknown)!r} is no axis. Known: {' '.join(AXES)}"
        )
    return tuple(trim.split())


def hover_action(law: Controller, height: float) -> Tensor:
    """Return the action at hover at a height [m], float64, (U,): ``law.hover_action``, else zeros, with the height."""
    given = getattr(law, "hover_action", ()) or [0.0] * len(law.action_names)
    entries = [height if name == HEIGHT_ENTRY else x for name, x in zip(law.action_names, given, strict=True)]
    return torch.tensor(entries, dtype=torch.float64)
