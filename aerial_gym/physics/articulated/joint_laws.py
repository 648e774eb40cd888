"""Laws of joints: springs, dampers, drives, limits, each with its effort and its derivatives by position and rate.

The derivatives stabilise stiff joints: an arm with a ratio of damping to inertia of 230 1/s diverges in steps of 10 ms if its
effort is constant over the step (``steppers``).
Drives with limits and dry friction are one mixed complementarity problem at the end of a step. A drive gives the effort of its
law there, within its limit; dry friction is such a drive to the rate 0. With the rates v of the joints at the end, their rates
v_0 without these laws, and the positive definite matrix B of a step between efforts and rates:

    B (v - v_0) = sum_i clamp(a_i - b_i v, -limit_i, limit_i),    b_i >= 0.

The right side falls with v, so v is the minimum of a strictly convex, piecewise quadratic function. Newton's method with an
exact line search finds it in a finite number of rounds; without the line search the set of limited drives may cycle. Each round
is a step under the tangents of the laws, so B is never formed: along the line between two steps rates and efforts are linear.
The fused kernel has its own loop of rounds, and is traced from ``EffortLimits``.
Letters: E environments, D joints, K bounded laws, T candidates of a line search.
Units: rad and N m, for joints that move m and N.

Sources: Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit steps); Sun (1997),
On piecewise quadratic Newton and trust region problems, Mathematical Programming 76, 451-467.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from aerial_gym.physics.articulated.tree import TreeState

STICK_RATE = 1e-3  # Rate below which dry friction is proportional to it [rad/s]; a sticking joint creeps


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Effort of joints with its derivatives."""

    value: Tensor  # [N m] or [N], (E, D)
    stiffness: Tensor  # Decrease of the effort per position, (E, D)
    damping: Tensor  # Decrease of the effort per rate, (E, D)

    def __add__(self, other: "Effort") -> "Effort":
        """Return the sum of two efforts."""
        return Effort(
            value=self.value + other.value,
            stiffness=self.stiffness + other.stiffness,
            damping=self.damping + other.damping,
        )

    def at_end_of_step(self, rate: Tensor, dt: Tensor | float) -> tuple[Tensor, Tensor]:
        """Return the effort at the end of a step without acceleration, ``f - K q' dt``, and its decrease ``C dt + K dt²``
        per acceleration, (E, D) each.

        Args:
            rate: Rates q' at the start, (E, D).
        """
        soft = self.stiffness * dt
        return self.value - soft * rate, dt * (self.damping + soft)


class JointLaw(Protocol):
    """A law of the effort of joints by position and rate."""

    def evaluate_effort(self, position: Tensor, rate: Tensor) -> Effort:
        """Return the effort at positions and rates (E, D)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Spring:
    """``p - (k + k2 |q - q0|) (q - q0) - c q'``: a spring, linear and quadratic, with a damper; tensors (E, D) or (1, D)."""

    stiffness: Tensor  # k [N m/rad]
    quadratic: Tensor  # k2 [N m/rad²]
    damping: Tensor  # c [N m s/rad]
    rest: Tensor  # q0 [rad]
    preload: Tensor  # p, effort at rest [N m]

    def evaluate_effort(self, position: Tensor, rate: Tensor) -> Effort:
        """Return the effort of spring and damper."""
        away = position - self.rest
        return Effort(
            value=self.preload - (self.stiffness + self.quadratic * away.abs()) * away - self.damping * rate,
            stiffness=self.stiffness + 2.0 * self.quadratic * away.abs(),
            damping=self.damping.expand_as(rate),
        )


@dataclass(frozen=True, kw_only=True)
class Creep:
    """``-sum k_i (q - z_i)``: springs behind dashpots, which follow by ``z_i' = (q - z_i) / T_i``. Letters: N elements a joint.

    A dashpot is constant over a step and updated at its end, exactly for a constant coordinate: order 1.

    Source:
        Generalised Maxwell model, Tschoegl (1989), The Phenomenological Theory of Linear Viscoelastic Behavior, section 3.4.
    """

    stiffness: Tensor  # k_i [N m/rad], (1, N, D); zero where a joint has fewer
    crept: Tensor  # z_i [rad], (E, N, D)

    def evaluate_effort(self, position: Tensor, rate: Tensor) -> Effort:
        """Return the effort of all elements."""
        return Effort(
            value=(self.stiffness * (self.crept - position.unsqueeze(1))).sum(1),
            stiffness=self.stiffness.sum(1).expand_as(rate),
            damping=torch.zeros_like(rate),
        )


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive to position and rate, ``k (q_c - q) + c (q'_c - q') + f``, within its limit; tensors (E, D) or (1, D)."""

    stiffness: Tensor  # k; zero for a drive to a rate
    damping: Tensor  # c
    position: Tensor  # q_c
    rate: Tensor  # q'_c
    effort: Tensor  # f, feed-forward effort
    limit: Tensor  # Largest effort

    def effort_demand(self, position: Tensor, rate: Tensor) -> Tensor:
        """Return the unlimited effort."""
        return self.stiffness * (self.position - position) + self.damping * (self.rate - rate) + self.effort


def dry_friction(size: Tensor) -> Drive:
    """Return dry friction of a size [N m], (1, D): a drive to the rate 0 with this limit.

    A sticking joint keeps a rate of at most ``STICK_RATE``. A moving joint slows down by the size, to rest without
    reversal. This is Coulomb's law at the end of a step.
    """
    zero = torch.zeros_like(size)
    return Drive(stiffness=zero, damping=size / STICK_RATE, position=zero, rate=zero, effort=zero, limit=size)


@dataclass(frozen=True, kw_only=True)
class JointLimits:
    """Soft ends of joints: beyond them a spring and damper push back and never pull; tensors (E, D) or (1, D)."""

    low: Tensor
    high: Tensor

    stiffness: Tensor  # [N m/rad]
    damping: Tensor  # [N m s/rad]

    def evaluate_effort(self, position: Tensor, rate: Tensor) -> Effort:
        """Return the effort beyond the ends."""
        past = (position - self.high).clamp_min(0.0) - (self.low - position).clamp_min(0.0)
        push = self.stiffness * past + self.damping * rate
        pushes = push * past > 0.0
        return Effort(
            value=torch.where(pushes, -push, 0.0),
            stiffness=torch.where(pushes, self.stiffness, 0.0),
            damping=torch.where(pushes, self.damping, 0.0),
        )


def joint_effort(laws: Sequence[JointLaw], position: Tensor, rate: Tensor) -> Effort:
    """Return the total effort of all laws at positions and rates (E, D)."""
    no_effort = torch.zeros_like(rate)
    total = Effort(value=no_effort, stiffness=no_effort, damping=no_effort)
    for law in laws:
        total = total + law.evaluate_effort(position, rate)
    return total


ROUNDS = 12  # Rounds of Newton's method; snakes of ten joints under random commands take at most 6
TOLERANCE = 1e-6  # Tolerance of an effort against its law, per limit, before it is held; above float32 rounding
EffortStep = Callable[[Effort], TreeState]  # A step under efforts of joints taken at its end


@dataclass(frozen=True, kw_only=True)
class EffortLimits:
    """Laws ``clamp(a - b v, -limit, limit)`` of drives and dry friction by the rates v at the end of a step."""

    demand: Tensor  # a: unlimited effort at the final rate 0 [N m] or [N], (E, K, D)
    slope: Tensor  # b: decrease of the effort per final rate, (E, K, D)
    limit: Tensor  # Largest effort, (E, K, D)

    @classmethod
    def at_end_of_step(cls, laws: Sequence[Drive], position: Tensor, dt: Tensor | float) -> "EffortLimits":
        """Return the laws at the end of a step of ``dt`` [s] from positions (E, D), by the position at the end."""
        still, each = torch.zeros_like(position), [(law, law.damping + dt * law.stiffness) for law in laws]
        rows = (
            [law.effort_demand(position, still) for law in laws],
            [slope for _, slope in each],
            [law.limit for law in laws],
        )
        demand, slope, limit = (torch.stack([own.expand_as(position) for own in part], dim=1) for part in rows)
        return cls(demand=demand, slope=slope, limit=limit)

    def effort_demand(self, rate: Tensor) -> Tensor:
        """Return the unlimited efforts at final rates (..., E, D), (..., E, K, D)."""
        return self.demand - self.slope * rate.unsqueeze(-2)

    def evaluate_effort(self, rate: Tensor) -> Tensor:
        """Return the efforts at final rates (..., E, D), within their limits, (..., E, K, D)."""
        return self.effort_demand(rate).clamp(-self.limit, self.limit)

    def side(self, rate: Tensor) -> Tensor:
        """Return the sign of each effort beyond its limit at final rates (E, D), 1 or -1; else 0, (E, K, D)."""
        demand = self.effort_demand(rate)
        return torch.where(demand > self.limit, 1.0, torch.where(demand < -self.limit, -1.0, 0.0))

    def tangent(self, side: Tensor) -> tuple[Tensor, Tensor]:
        """Return the efforts at the final rate 0 and their slopes, (E, K, D), of laws at their limit or unlimited."""
        free = side == 0.0
        return torch.where(free, self.demand, side * self.limit), torch.where(free, self.slope, 0.0)

    def contradicts(self, side: Tensor, rate: Tensor) -> Tensor:
        """Return whether any law of a row has another side than ``side`` at final rates (E, D), beyond the tolerance, (E,)."""
        demand = self.effort_demand(rate)
        miss = torch.where(side == 0.0, demand.abs() - self.limit, self.limit - side * demand)
        return (miss > TOLERANCE * self.limit).flatten(1).any(1)

    def line_slope(self, rate: Tensor, effort: Tensor, way: Tensor) -> Tensor:
        """Return the slope along ``way`` of the convex function whose minimum solves the problem, (..., E).

        Args:
            rate: Final rates, (..., E, D).
            effort: Total effort that gives them, (..., E, D).
            way: Change of the rates along the line, (E, D).
        """
        return (way * (effort - self.evaluate_effort(rate).sum(-2))).sum(-1)


def has_driving_friction(friction: Tensor, rate: Tensor) -> Tensor:
    """Return whether the friction of any joint acts along its final rate, (E,); both (E, D)."""
    return (friction * rate > 0.0).any(1)


@dataclass(frozen=True, kw_only=True)
class LimitState:
    """State of bounded laws over a step."""

    side: Tensor  # Sign of the effort of a law at its limit, 1 or -1; else 0, (E, K, D)
    effort: Tensor  # Effort in rows where `is_held` is true [N m] or [N], (E, K, D)
    is_held: Tensor  # Whether the constant `effort` replaces the law and its limit, (E, 1, 1)


@dataclass(frozen=True, kw_only=True)
class _StepEnd:
    """Rates at the end of a step, and the efforts of the step."""

    rate: Tensor  # [rad/s] or [m/s], (E, D)
    effort: Tensor  # Total effort of all laws, (E, D)


@dataclass(frozen=True, kw_only=True)
class DriveLimitAndFrictionProblem:
    """Complementarity problem of the efforts of limited drives and dry friction in one step, with the state at its start."""

    laws: EffortLimits  # Drives and dry friction, K of them
    friction: Sequence[bool]  # Whether each law is dry friction
    acts: Effort  # Efforts of the other laws at the start of the step
    state: TreeState  # Motion at the start of the step
    rounds: int = ROUNDS  # Rounds of Newton's method, at most

    def total_effort(self, bounded: LimitState) -> Effort:
        """Return the total effort of all joint laws, bounded and unbounded."""
        value, slope = (own.sum(1) for own in self._lines(bounded))
        return self.acts + Effort(
            value=value - slope * self.state.joint_vel, stiffness=torch.zeros_like(slope), damping=slope
        )

    def law_efforts(self, bounded: LimitState, end: TreeState) -> Tensor:
        """Return the effort of each law in a step with the given end, (E, K, D)."""
        value, slope = self._lines(bounded)
        return value - slope * end.joint_vel.unsqueeze(1)

    def _lines(self, bounded: LimitState) -> tuple[Tensor, Tensor]:
        """Return the efforts at the final rate 0 and their slopes, (E, K, D)."""
        value, slope = self.laws.tangent(bounded.side)
        return torch.where(bounded.is_held, bounded.effort, value), torch.where(bounded.is_held, 0.0, slope)

    @torch.no_grad()
    def solve(self, step: EffortStep, guess: TreeState) -> LimitState:
        """Solve the problem; the first round uses the limited laws of the motion ``guess``.

        An unsolved row gets constant efforts within the limits, without friction along the motion, so no row exceeds a limit.
        """
        side = self.laws.side(guess.joint_vel)
        at = self._tangent_step(step, side)
        solved = self._is_solved(side, at)
        for _ in range(self.rounds):
            if self._is_done(solved):
                break
            side = self.laws.side(at.rate)
            end = self._tangent_step(step, side)
            now = self._is_solved(side, end)
            share = torch.where(now, 1.0, self._line_search(at, end))
            share = torch.where(solved, 0.0, share).unsqueeze(-1)
            at = _StepEnd(**{name: torch.lerp(a, getattr(end, name), share) for name, a in vars(at).items()})
            solved = solved | now
        return self._within_limits(step, at.rate, solved)

    def _is_done(self, solved: Tensor) -> bool:
        """Return whether all rows are solved; False on a GPU, which runs all rounds to avoid waiting.

        Further rounds keep solved rows bit for bit.
        """
        return not solved.is_cuda and bool(solved.all())

    def _make_state(self, side: Tensor) -> LimitState:
        return LimitState(side=side, effort=torch.zeros_like(side), is_held=torch.zeros_like(side[:, :1, :1]).bool())

    def _tangent_step(self, step: EffortStep, side: Tensor) -> _StepEnd:
        """Return the end of a step in which each law is at its limit or unlimited, by ``side``."""
        bounded = self._make_state(side)
        end = step(self.total_effort(bounded))
        return _StepEnd(rate=end.joint_vel, effort=self.law_efforts(bounded, end).sum(1))

    def _is_solved(self, side: Tensor, end: _StepEnd) -> Tensor:
        """Return whether the limited laws at the end of a step equal those of the step, (E,)."""
        return (side == self.laws.side(end.rate)).flatten(1).all(1)

    def _line_search(self, start: _StepEnd, end: _StepEnd) -> Tensor:
        """Return the minimum of the convex function between ``start`` and ``end``, as a share in [0, 1], (E,).

        Its slope rises along the line, and is linear between the points where a law reaches or leaves a limit.
        """
        way, first, limit = end.rate - start.rate, self.laws.effort_demand(start.rate), self.laws.limit
        change = self.laws.effort_demand(end.rate) - first
        places = torch.cat(((limit - first) / change, (-limit - first) / change), dim=1)
        places = places.nan_to_num(1.0).clamp(0.0, 1.0).flatten(1)
        ends = torch.zeros_like(places[:, :1])
        share = torch.cat((ends, ends + 1.0, places), dim=1).sort(dim=1).values  # (E, T)
        part = share.T.unsqueeze(-1)
        effort = start.effort + part * (end.effort - start.effort)
        return _find_zero(share, self.laws.line_slope(start.rate + part * way, effort, way).T)

    def _within_limits(self, step: EffortStep, rate: Tensor, solved: Tensor) -> LimitState:
        """Return the bounded laws at final rates (E, D); unsolved rows have constant efforts."""
        result = self._make_state(self.laws.side(rate))
        if self._is_done(solved):
            return result
        misses = self.laws.contradicts(result.side, self._tangent_step(step, result.side).rate)
        result = replace(result, effort=self.laws.evaluate_effort(rate), is_held=misses[:, None, None])
        after = step(self.total_effort(result))
        effort = [
            torch.where(has_driving_friction(own, after.joint_vel).unsqueeze(1), 0.0, own) if rubs else own
            for own, rubs in zip(result.effort.unbind(1), self.friction, strict=True)
        ]
        return replace(result, effort=torch.stack(effort, dim=1))


def _find_zero(share: Tensor, slope: Tensor) -> Tensor:
    """Return the zero of a rising, piecewise linear slope, (E,); 1 if the slope is negative up to 1.

    Args:
        share: Places in ascending order, (E, T).
        slope: Values there, (E, T).
    """
    after = (slope > 0.0).long().argmax(dim=1, keepdim=True).clamp_min(1)
    (x, y), (x_0, y_0) = ([each.gather(1, at) for each in (share, slope)] for at in (after, after - 1))
    rise = y - y_0
    zero = x_0 - torch.where(rise > 0.0, y_0 / rise, 0.0) * (x - x_0)
    return torch.where((slope > 0.0).any(dim=1), zero.squeeze(1).clamp(0.0, 1.0), 1.0)
