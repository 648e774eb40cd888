"""Laws of joints: springs, dampers, drives, limits, each with its effort and its derivatives by position and rate.

The derivatives stabilise stiff joints: an arm with a ratio of damping to inertia of 230 1/s diverges in steps of 10 ms if its
effort is constant over the step (``steppers``).
Letters: E environments, D joints. Units: rad and N m, for joints that move m and N.

Source: Hairer, Wanner (1996), Solving Ordinary Differential Equations II, section IV.8 (linearly implicit steps).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

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
