"""Drives with limits and dry friction at the end of a step: one mixed complementarity problem.

A drive gives the effort of its law at the end of the step, within its limit. Dry friction is such a drive to the rate 0. With
the rates v of the joints at the end, their rates v_0 without these laws, and the positive definite matrix B of a step between
efforts and rates:

    B (v - v_0) = sum_i clamp(a_i - b_i v, -limit_i, limit_i),    b_i >= 0.

The right side falls with v, so v is the minimum of a strictly convex, piecewise quadratic function. Newton's method with an
exact line search finds it in a finite number of rounds; without the line search the set of limited drives may cycle. Each round
is a step under the tangents of the laws, so B is never formed: along the line between two steps rates and efforts are linear.
Letters: E environments, D joints, K bounded laws, T candidates of a line search.

Source: Sun (1997), On piecewise quadratic Newton and trust region problems, Mathematical Programming 76, 451-467.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from aerial_gym.physics.articulated.joint_laws import Drive, Effort
from aerial_gym.physics.articulated.tree import TreeState

ROUNDS = 12
"""Rounds of Newton's method; snakes of ten joints under random commands take at most 6."""

TOLERANCE = 1e-6
"""Tolerance of an effort against its law, as a share of the limit, before it is held constant; above float32 rounding."""

EffortStep = Callable[[Effort], TreeState]
"""A step under efforts of joints taken at its end."""


@dataclass(frozen=True, kw_only=True)
class LimitState:
    """State of bounded laws over a step, each tensor (K, E, D)."""

    side: Tensor  # Sign of the effort of a law at its limit, 1 or -1; else 0
    effort: Tensor  # Effort in rows where `is_held` is true [N m] or [N]
    is_held: Tensor  # Whether the constant `effort` replaces the law and its limit, (1, E, 1)

    def evaluate_effort(self, laws: Sequence[Drive], position: Tensor, rate: Tensor) -> Sequence[Effort]:
        """Return the efforts of the laws at a motion (E, D)."""
        result = []
        for law, side, effort in zip(laws, self.side, self.effort, strict=True):
            own, held = law.evaluate_effort(position, rate, side), self.is_held[0]
            result.append(
                Effort(
                    value=torch.where(held, effort, own.value),
                    stiffness=torch.where(held, 0.0, own.stiffness),
                    damping=torch.where(held, 0.0, own.damping),
                )
            )
        return result


@dataclass(frozen=True, kw_only=True)
class _Point:
    """Rates at the end of a step, and the efforts of the step."""

    rate: Tensor  # [rad/s] or [m/s], (E, D)
    wanted: Tensor  # Unlimited effort of each law at these rates, (K, E, D)
    effort: Tensor  # Total effort of all laws, (E, D)


@dataclass(frozen=True, kw_only=True)
class ComplementarityProblem:
    """Bounded laws of joints, and the step in which they act."""

    laws: Sequence[Drive]  # Drives and dry friction, K of them
    friction: Sequence[bool]  # Whether each law is dry friction
    acts: Effort  # Efforts of the other laws at the start of the step
    state: TreeState  # Motion at the start of the step
    rounds: int = ROUNDS  # Rounds of Newton's method, at most

    @cached_property
    def limit(self) -> Tensor:
        """Return the limits of the laws, (K, E, D)."""
        return torch.stack([law.limit.expand_as(self.state.joint_pos) for law in self.laws])

    def effort_demand(self, position: Tensor, rate: Tensor) -> Tensor:
        """Return the unlimited efforts of the laws at positions and rates (E, D), (K, E, D)."""
        return torch.stack([law.effort_demand(position, rate).expand_as(position) for law in self.laws])

    def side(self, wanted: Tensor) -> Tensor:
        """Return ``Drive.side`` of each law, (K, E, D)."""
        return torch.stack([law.side(own) for law, own in zip(self.laws, wanted, strict=True)])

    def total(self, bounded: LimitState) -> Effort:
        """Return the total effort of all joint laws, bounded and unbounded."""
        result = self.acts
        for effort in bounded.evaluate_effort(self.laws, self.state.joint_pos, self.state.joint_vel):
            result = result + effort
        return result

    @torch.no_grad()
    def solve(self, step: EffortStep, guess: TreeState) -> LimitState:
        """Solve the problem; the first round uses the limited laws of the motion ``guess``.

        An unsolved row gets constant efforts within the limits, without friction along the motion, so no row exceeds a limit.
        """
        wanted = self.effort_demand(guess.joint_pos, guess.joint_vel)
        at = self._tangent_step(step, self.side(wanted))
        solved = self._is_solved(wanted, at)
        for _ in range(self.rounds):
            if self._is_done(solved):
                break
            end = self._tangent_step(step, self.side(at.wanted))
            now = self._is_solved(at.wanted, end)
            share = torch.where(now, 1.0, self._line_search(at, end))
            share = torch.where(solved, 0.0, share).unsqueeze(-1)
            at = _Point(**{name: torch.lerp(a, getattr(end, name), share) for name, a in vars(at).items()})
            solved = solved | now
        return self._within_limits(step, at.wanted, solved)

    def _is_done(self, solved: Tensor) -> bool:
        """Return whether all rows are solved; False on a GPU, which runs all rounds to avoid waiting.

        Further rounds keep solved rows bit for bit.
        """
        return not solved.is_cuda and bool(solved.all())

    def _make_state(self, side: Tensor) -> LimitState:
        return LimitState(side=side, effort=torch.zeros_like(side), is_held=torch.zeros_like(side[:1, :, :1]).bool())

    def _tangent_step(self, step: EffortStep, side: Tensor) -> _Point:
        """Return the end of a step in which each law is at its limit or unlimited, by ``side``."""
        end = step(self.total(self._make_state(side)))
        wanted = self.effort_demand(end.joint_pos, end.joint_vel)
        applied = torch.where(side == 0.0, wanted, side * self.limit)
        return _Point(rate=end.joint_vel, wanted=wanted, effort=applied.sum(0))

    def _is_solved(self, before: Tensor, end: _Point) -> Tensor:
        """Return whether the limited laws at the end of a step equal those of the step, (E,)."""
        return (self.side(before) == self.side(end.wanted)).all(-1).all(0)

    def _line_search(self, start: _Point, end: _Point) -> Tensor:
        """Return the minimum of the convex function between ``start`` and ``end``, as a share in [0, 1], (E,).

        Its slope rises along the line, and is linear between the points where a law reaches or leaves a limit.
        """
        way, limit = end.wanted - start.wanted, self.limit
        places = torch.cat((limit - start.wanted, -limit - start.wanted)) / torch.cat((way, way))
        places = places.nan_to_num(1.0).clamp(0.0, 1.0).permute(1, 0, 2).flatten(1)
        ends = torch.zeros_like(places[:, :1])
        share = torch.cat((ends, ends + 1.0, places), dim=1).sort(dim=1).values  # (E, T)
        part = share.T.unsqueeze(-1)
        given = (start.wanted.unsqueeze(1) + part * way.unsqueeze(1)).clamp(-limit.unsqueeze(1), limit.unsqueeze(1))
        effort = start.effort + part * (end.effort - start.effort)
        slope = ((end.rate - start.rate) * (effort - given.sum(0))).sum(-1).T
        return _find_zero(share, slope)

    def _within_limits(self, step: EffortStep, wanted: Tensor, solved: Tensor) -> LimitState:
        """Return the bounded laws at the efforts ``wanted``; unsolved rows have constant efforts."""
        limit, result = self.limit, self._make_state(self.side(wanted))
        if self._is_done(solved):
            return result
        end = self._tangent_step(step, result.side).wanted
        misses = torch.where(result.side == 0.0, end.abs() - limit, limit - result.side * end)
        is_held = (misses > TOLERANCE * limit).any(-1).any(0)[None, :, None]
        result = replace(result, effort=wanted.clamp(-limit, limit), is_held=is_held)
        after = step(self.total(result))
        pushes = (result.effort * self.effort_demand(after.joint_pos, after.joint_vel) < 0.0).any(-1, keepdim=True)
        effort = [
            torch.where(along, 0.0, own) if rubs else own
            for own, along, rubs in zip(result.effort, pushes, self.friction, strict=True)
        ]
        return replace(result, effort=torch.stack(effort))


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
