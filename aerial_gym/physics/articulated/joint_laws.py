"""What acts in joints: springs, dampers, drives, limits. Each says its effort and how that falls with position and rate.

The derivatives make stiff joints stable: an arm whose damping over its inertia is 230 1/s diverges in steps of 10 ms if its
effort is held through the step (``steppers``).
Letters: E environments, D joints. Units: rad and N m, for joints that move m and N.

Source: Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit steps).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

STICK_RATE = 1e-3
"""Below which dry friction grows with the rate [rad/s], so that a joint that it holds creeps."""


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What acts on joints."""

    value: Tensor  # [N m] or [N], (E, D)
    stiffness: Tensor  # By how much it falls per position, (E, D)
    damping: Tensor  # By how much it falls per rate, (E, D)

    def __add__(self, other: "Effort") -> "Effort":
        """Return both together."""
        return Effort(
            value=self.value + other.value,
            stiffness=self.stiffness + other.stiffness,
            damping=self.damping + other.damping,
        )


class JointLaw(Protocol):
    """What acts in joints, by their position and rate."""

    def effort_at(self, position: Tensor, rate: Tensor) -> Effort:
        """Return what acts at positions and rates (E, D)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Spring:
    """``p - (k + k2 |q - q0|) (q - q0) - c q'``: a spring, linear and quadratic, with a damper; tensors (E, D) or (1, D)."""

    stiffness: Tensor  # k [N m/rad]
    quadratic: Tensor  # k2 [N m/rad²]
    damping: Tensor  # c [N m s/rad]
    rest: Tensor  # q0 [rad]
    preload: Tensor  # p, what it holds at rest [N m]

    def effort_at(self, position: Tensor, rate: Tensor) -> Effort:
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

    What a dashpot follows is held through a step, at whose end it is exact for a coordinate that stays: order 1.

    Source:
        Generalised Maxwell model, Tschoegl (1989), The Phenomenological Theory of Linear Viscoelastic Behavior, section 3.4.
    """

    stiffness: Tensor  # k_i [N m/rad], (1, N, D); zero where a joint has fewer
    crept: Tensor  # z_i [rad], (E, N, D)

    def effort_at(self, position: Tensor, rate: Tensor) -> Effort:
        """Return the effort of all elements."""
        return Effort(
            value=(self.stiffness * (self.crept - position.unsqueeze(1))).sum(1),
            stiffness=self.stiffness.sum(1).expand_as(rate),
            damping=torch.zeros_like(rate),
        )


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive to a position and a rate, ``k (q_c - q) + c (q'_c - q') + f``, within what it can; tensors (E, D) or (1, D)."""

    stiffness: Tensor  # k; zero for a drive to a rate
    damping: Tensor  # c
    position: Tensor  # q_c
    rate: Tensor  # q'_c
    effort: Tensor  # f, asked for as it is
    limit: Tensor  # Largest effort

    def effort_demand(self, position: Tensor, rate: Tensor) -> Tensor:
        """Return the effort that is asked for, beyond the limit or not."""
        return self.stiffness * (self.position - position) + self.damping * (self.rate - rate) + self.effort

    def saturation_side(self, position: Tensor, rate: Tensor) -> Tensor:
        """Return 1 or -1 where more is asked for than the drive can give, by its sign; else 0."""
        return self.side(self.effort_demand(position, rate))

    def side(self, wanted: Tensor) -> Tensor:
        """Return 1 or -1 where an effort is beyond the limit, by its sign; else 0."""
        return torch.where(wanted.abs() > self.limit, torch.sign(wanted), 0.0)

    def effort_at(self, position: Tensor, rate: Tensor, at_limit: Tensor) -> Effort:
        """Return the effort; where ``at_limit`` is 1 or -1 it is the limit to that side, and falls with nothing."""
        free = at_limit == 0.0
        return Effort(
            value=torch.where(free, self.effort_demand(position, rate), at_limit * self.limit),
            stiffness=torch.where(free, self.stiffness, 0.0),
            damping=torch.where(free, self.damping, 0.0),
        )


def dry_friction(size: Tensor) -> Drive:
    """Return dry friction of a size [N m], (1, D): a drive to the rate 0 that can give no more.

    At most ``STICK_RATE`` is left of the motion of a joint that it holds; what moves, it slows down by its size, and brings to
    rest in the step in which it can: it turns nothing round. Coulomb's law, taken at the end of a step.
    """
    zero = torch.zeros_like(size)
    return Drive(stiffness=zero, damping=size / STICK_RATE, position=zero, rate=zero, effort=zero, limit=size)


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Soft ends: beyond them a spring with a damper pushes back, and never pulls; tensors (E, D) or (1, D)."""

    low: Tensor
    high: Tensor

    stiffness: Tensor  # [N m/rad]
    damping: Tensor  # [N m s/rad]

    def effort_at(self, position: Tensor, rate: Tensor) -> Effort:
        """Return the effort beyond the ends."""
        past = (position - self.high).clamp_min(0.0) - (self.low - position).clamp_min(0.0)
        side = torch.sign(past)
        back = (self.stiffness * past + self.damping * rate) * side
        pushes = back > 0.0
        return Effort(
            value=torch.where(pushes, -side * back, 0.0),
            stiffness=torch.where(pushes, self.stiffness, 0.0),
            damping=torch.where(pushes, self.damping, 0.0),
        )


def joint_effort(laws: Sequence[JointLaw], position: Tensor, rate: Tensor) -> Effort:
    """Return what all laws together do at positions and rates (E, D)."""
    nothing = torch.zeros_like(rate)
    found = Effort(value=nothing, stiffness=nothing, damping=nothing)
    for law in laws:
        found = found + law.effort_at(position, rate)
    return found
