"""Water around a hull: buoyancy, damping, and the mass and inertia of the water that moves with it.

Letters: E environments.
"""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import ANY_ROTOR, Parameter
from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds import FluidEffect, LinearWrenchEffect, VehicleEffect, WrenchEffect
from aerial_gym.physics.vehicle import Vehicle


class Buoyancy(WrenchEffect):
    """Buoyancy: the weight of displaced water pushes a hull up at the centre of its displaced volume.

    With b from the body origin to the centre of buoyancy and c to the centre of mass, the force F along world z acts at b.
    Its torque about the centre of mass, ``(b - c) x F``, rights a hull whose centre of buoyancy is above its centre of
    mass. The buoyancy of air, a thousandth of it, is neglected elsewhere. The hull is always submerged: there is no
    surface.
    Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 4.1 (submerged vehicles).
    """

    name = "buoyancy"
    summary = "upward force of displaced water, at the centre of buoyancy"
    parameters = (
        Parameter("force", "N", 0.0, 1e5, 1.0, "weight of the displaced water"),
        *(Parameter(axis, "m", -5.0, 5.0, 0.01, f"centre of buoyancy from the body origin, {axis}") for axis in "xyz"),
    )
    excitation = "attitudes that differ"
    confused_with = ("payload_mass", "com_offset", "thrust_coefficient")
    rotors = ANY_ROTOR
    medium = "water"

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        """Return ``F up`` and ``(b - c) x F up``."""
        return buoyancy_wrench(params[:, :1], params[:, 1:] - condition.vehicle.com, condition.up)


def buoyancy_wrench(force: Tensor, lever: Tensor, up: Tensor) -> Tensor:
    """Return force [N] and torque [N m], (..., 6), of an upward force [N], (..., 1).

    It acts at a lever [m] from the centre of mass; that and world z are in axes of the body, (..., 3).
    """
    push = force * up
    return torch.cat((push, torch.linalg.cross(lever, push)), dim=-1)


_MEANING = {
    "l": ("N s/m", 1.0, "force per speed along body"),
    "q": ("N s²/m²", 1.0, "force per speed squared along body"),
    "a": ("N m s/rad", 0.01, "torque per rate about body"),
    "b": ("N m s²/rad²", 0.01, "torque per rate squared about body"),
}


class HullDrag(LinearWrenchEffect):
    """Damping of a hull in water: linear and quadratic, along and about each body axis.

    ``F_i = -(l_i + q_i |v_i|) v_i`` and ``tau_i = -(a_i + b_i |w_i|) w_i`` at the centre of mass, v through the water. Each
    axis is by itself, as tank tests give it; ``quadratic_drag`` is the law for a body in air, with the speed in place of
    ``|v_i|``.
    Source: Fossen (2021), Handbook of Marine Craft Hydrodynamics and Motion Control, section 8.1 (uncoupled motions).
    """

    name = "hull_drag"
    summary = "damping of a hull in water: linear and quadratic, along and about each body axis"
    parameters = tuple(
        Parameter(f"{letter}{axis}", unit, 0.0, 1e4, scale, f"{meaning} {axis}")
        for letter, (unit, scale, meaning) in _MEANING.items()
        for axis in "xyz"
    )
    excitation = "several speeds through the water and rates along and about each body axis"
    confused_with = ("rotor_drag", "quadratic_drag", "constant_wind")
    rotors = ANY_ROTOR
    medium = "water"
    follows = ("velocity",)

    def regressor(self, condition: Condition) -> Tensor:
        """Return ``-diag(v), -diag(|v| v), -diag(w), -diag(|w| w)`` in their places, (E, 6, 12)."""
        v, w = condition.air_velocity, condition.ang_vel
        along, about = (torch.cat([torch.diag_embed(u), torch.diag_embed(u.abs() * u)], dim=-1) for u in (v, w))
        none = torch.zeros_like(along)
        return -torch.cat((torch.cat((along, none), dim=-1), torch.cat((none, about), dim=-1)), dim=1)


class AddedMass(FluidEffect):
    """Added mass: water that accelerates with a hull adds to its mass along each body axis.

    With added masses M_A = diag(x, y, z) at the centre of mass, v through water in steady uniform motion, and the weight m
    g::

        (m + M_A) a = F + m g + M_A (w x v) - w x (M_A v)      in body axes, a the acceleration in the world
        J w' = tau - w x J w - v x (M_A v)

    The last term, Munk's moment, turns a slender hull across its motion. Pendulum period, terminal speed and the energy
    ``1/2 v (m + M_A) v + 1/2 w J w`` are correct. ``added_inertia`` is the rotational counterpart.
    Source: Lamb (1932), Hydrodynamics, articles 121-124 (Kirchhoff's equations); Fossen (2021), section 6.3.
    """

    name = "added_mass"
    summary = "water that is accelerated with a hull: added mass along each body axis, and the moment of Munk"
    parameters = tuple(Parameter(axis, "kg", 0.0, 1e4, 1.0, f"added mass along body {axis}") for axis in "xyz")
    excitation = "accelerations along each body axis"
    confused_with = ("payload_mass", "thrust_coefficient")
    instead = ("link_added_mass",)
    medium = "water"

    def added_mass(self, params: Tensor) -> Tensor:
        """Return the mass of the water along each body axis [kg], (E, 3): the parameters."""
        return params

    def wrench_with_fluid(self, wrench: Tensor, condition: Condition, gravity: float, params: Tensor) -> Tensor:
        """Return ``S (F + N) + (1 - S) m g up`` with ``S = m / (m + M_A)``, and ``tau - v x (M_A v)``."""
        mass, v, w = condition.vehicle.mass.unsqueeze(-1), condition.air_velocity, condition.ang_vel
        share, momentum = mass / (mass + params), params * v
        turning = params * torch.linalg.cross(w, v) - torch.linalg.cross(w, momentum)
        force = share * (wrench[:, :3] + turning) + (1.0 - share) * mass * gravity * condition.up
        return torch.cat((force, wrench[:, 3:] - torch.linalg.cross(v, momentum)), dim=-1)


class AddedInertia(VehicleEffect):
    """Added inertia: water that rotates with a hull adds to its moment of inertia about each body axis.

    ``J = J_declared + diag(x, y, z)`` about the centre of mass.
    Source: Lamb (1932), Hydrodynamics, articles 121-124; the other half of ``added_mass``.
    """

    name = "added_inertia"
    summary = "water that rotates with a hull: added inertia about each body axis"
    acts_on = "inertia"
    parameters = tuple(Parameter(axis, "kg m²", 0.0, 1e4, 0.1, f"added inertia about body {axis}") for axis in "xyz")
    excitation = "angular accelerations about each body axis"
    confused_with = ("inertia_error",)
    rotors = ANY_ROTOR
    on_joints = False
    instead = ("link_added_mass",)
    medium = "water"

    def adjust(self, vehicle: Vehicle, params: Tensor) -> Vehicle:
        """Return the vehicle with the inertia added."""
        return replace(vehicle, inertia=vehicle.inertia + torch.diag_embed(params))
