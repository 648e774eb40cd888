"""A payload that swings below the vehicle. Letters: E environments."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.config.robot import RobotCfg
from aerial_gym.math.rows import dot, inverse_3x3
from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.effects.kinds import LoadEffect, SuspensionMotion

FITTED_LENGTHS = (0.3, 0.5, 0.8, 1.3, 2.1)  # Initial lengths of links in fits [m]; frequencies 1.3 times apart
LIGHTEST = 1e-3  # Lightest payload in fits, as a share of the vehicle's mass
STRONGEST = 0.1  # Strongest damping in fits, per mass of the vehicle [1/s]
LEAST_MASS = 1e-6  # Least mass in the equation of the swing [kg]; a lighter payload still pulls by its own weight


class SlungPayload(LoadEffect):
    """Slung payload: a point mass that swings below the body origin on a massless rigid link.

    With the unit vector n from the origin to the mass m at the distance l, the acceleration a of the origin, and the
    damping c of the swing, a force ``-c l n'`` on the mass by its velocity ``l n'`` relative to the origin, across the
    link::

        T = m (g . n - a . n + l n'²)                   tension of the link
        F = T n + c l n'                                force on the origin: of the link, and the reaction of the damping
        n'' = (1 - n n^T) (g - a) / l - c / m n' - n'² n

    a itself depends on F, by the mobility A of the origin: ``a = a_0 + A F``; both equations are linear in T, so the
    coupled accelerations are exact. Small swings below a fixed origin decay by ``exp(-c t / 2 m)``. The mass has no drag:
    in steady flight it hangs along the apparent gravity. The link also pushes (T < 0), like a rod. The mass has no contact
    with ground or obstacles, and contact impulses do not reach it. No direction is singular: n and n' are vectors,
    normalised to ``|n| = 1``, ``n . n' = 0`` after each step.
    Source: Lee, Sreenath, Kumar (2013), Geometric control of cooperating multiple quadrotor UAVs with a suspended payload,
    eq. 1-4, for one vehicle, with a damping and a suspension beside the centre of mass added; derived from Newton's law for
    both bodies.
    """

    name = "slung_payload"
    summary = "point mass that swings below the body origin on a rigid link"
    parameters = (
        Parameter("mass", "kg", 0.0, 50.0, 0.05, "of the payload"),
        Parameter("length", "m", 0.01, 100.0, 0.2, "from the body origin", neutral=1.0),
        Parameter("damping", "N s/m", 0.0, 10.0, 0.01, "force on the payload per velocity across the link"),
    )
    excitation = "sideways accelerations, and flights of several swings"
    confused_with = ("payload_mass", "gusts", "com_offset", "thrust_coefficient")
    law = "point mass on a rigid link"

    def starts(self, robot: RobotCfg) -> list[tuple[float, ...]]:
        """Return starts with 5 % of the vehicle's mass on links of several lengths, with strong damping.

        A weakly damped swing has a sharp frequency, which a fit from another frequency misses. A damping of the mass per second
        widens it to about the spacing of these lengths.
        """
        mass = 0.05 * robot.body.mass
        return [(mass, length, mass) for length in FITTED_LENGTHS]

    def bounds(self, robot: RobotCfg) -> list[tuple[float, float]]:
        """Return the bounds: at most the vehicle's own mass, at least a thousandth of it."""
        mass = robot.body.mass
        return [(LIGHTEST * mass, mass), (0.1, 20.0), (0.0, STRONGEST * mass)]

    def pull(self, suspension: SuspensionMotion, load: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return F and n''."""
        mass, length, damping = (params[:, k : k + 1] for k in range(3))
        direction, rate = load[:, :3], load[:, 3:]
        square = dot(rate, rate).unsqueeze(-1)
        reaction = damping * length * rate
        yielding = dot(suspension.mobility, direction.unsqueeze(-2))
        ax, ay, az = suspension.acceleration.unbind(-1)
        hanging = torch.stack((-ax, -ay, -az - suspension.gravity), dim=-1)
        hanging = hanging - dot(suspension.mobility, reaction.unsqueeze(-2))
        along = mass * (dot(hanging, direction).unsqueeze(-1) + length * square)
        tension = along / (1.0 + mass * dot(yielding, direction).unsqueeze(-1))
        push = hanging - yielding * tension
        across = push - dot(push, direction).unsqueeze(-1) * direction
        swing = across / length - damping / mass.clamp_min(LEAST_MASS) * rate - square * direction
        return tension * direction + reaction, swing


class RodPayload(SlungPayload):
    """Slung payload as a uniform rod that hangs on the body origin, such as a probe or a chain that stays straight.

    A rod of mass m and length l has the mass, moment and inertia about the joint of a mass ``m / 4`` at the joint and ``3 m
    / 4`` on a link of ``2 l / 3``. The first one gives ``F_0 = (m / 4) (g - a)``, so that the origin without load moves with
    ``a_0' = B (a_0 + (m / 4) A g)`` and has the mobility ``A' = B A``, ``B = (1 + (m / 4) A)^-1``.
    Source: Derived: static moments ``m``, ``m l / 2`` and ``m l² / 3`` of the rod (equimomental system).
    """

    name = "slung_payload_rod"
    summary = "uniform rod that swings below the body origin"
    law_of, law, in_place = "slung_payload", "uniform rod", True

    def start_in_place(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the rod that swings like a point mass: its length is 3/2 of the link's, its mass 4/3."""
        return {**values, "mass": values["mass"] * (4.0 / 3.0), "length": 1.5 * values["length"]}

    def in_first_law(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the point mass that swings like the rod."""
        return {**values, "mass": 0.75 * values["mass"], "length": values["length"] / 1.5}

    def pull(self, suspension: SuspensionMotion, load: Tensor, params: Tensor) -> tuple[Tensor, Tensor]:
        """Return F and n''."""
        mass, length, damping = (params[:, k : k + 1] for k in range(3))
        still, mobility = 0.25 * mass, suspension.mobility
        fall = torch.zeros_like(suspension.acceleration)
        fall = torch.stack((fall[:, 0], fall[:, 1], fall[:, 2] - suspension.gravity), dim=-1)
        one = torch.diag_embed(torch.ones_like(fall))
        inverse = inverse_3x3(one + still.unsqueeze(-1) * mobility)
        loaded = suspension.acceleration + still * dot(mobility, fall.unsqueeze(-2))
        heavier = SuspensionMotion(
            acceleration=dot(inverse, loaded.unsqueeze(-2)), mobility=inverse @ mobility, gravity=suspension.gravity
        )
        swinging = torch.cat((3.0 * still, length * (2.0 / 3.0), damping), dim=-1)
        force, swing = super().pull(heavier, load, swinging)
        moved = heavier.acceleration + dot(heavier.mobility, force.unsqueeze(-2))
        return force + still * (fall - moved), swing
