"""Added mass: water that accelerates with a hull adds to its mass along each body axis.

With added masses M_A = diag(x, y, z) at the centre of mass, v through water in steady uniform motion, and the weight m g::

    (m + M_A) a = F + m g + M_A (w x v) - w x (M_A v)      in body axes, a the acceleration in the world
    J w' = tau - w x J w - v x (M_A v)

The last term, Munk's moment, turns a slender hull across its motion. Pendulum period, terminal speed and the energy
``1/2 v (m + M_A) v + 1/2 w J w`` are correct. ``added_inertia`` is the rotational counterpart.
Source: Lamb (1932), Hydrodynamics, articles 121-124 (Kirchhoff's equations); Fossen (2021), section 6.3.
"""

import torch
from torch import Tensor

from aerial_gym.physics.effects.condition import Condition
from aerial_gym.physics.effects.kinds.fluid import FluidEffect
from aerial_gym.physics.effects.parameter import Parameter


class AddedMass(FluidEffect):
    """Mass of the fluid along each body axis."""

    name = "added_mass"
    summary = "water that is accelerated with a hull: added mass along each body axis, and the moment of Munk"
    parameters = tuple(Parameter(axis, "kg", 0.0, 1e4, 1.0, f"added mass along body {axis}") for axis in "xyz")
    excitation = "accelerations along each body axis"
    confused_with = ("payload_mass", "thrust_coefficient")
    instead = ("link_added_mass",)
    medium = "water"

    def added_mass(self, params: Tensor) -> Tensor:
        """Return the parameters."""
        return params

    def wrench_with_fluid(self, wrench: Tensor, condition: Condition, gravity: float, params: Tensor) -> Tensor:
        """Return ``S (F + N) + (1 - S) m g up`` with ``S = m / (m + M_A)``, and ``tau - v x (M_A v)``."""
        mass, v, w = condition.vehicle.mass.unsqueeze(-1), condition.air_velocity, condition.ang_vel
        share, momentum = mass / (mass + params), params * v
        turning = params * torch.linalg.cross(w, v) - torch.linalg.cross(w, momentum)
        force = share * (wrench[:, :3] + turning) + (1.0 - share) * mass * gravity * condition.up
        return torch.cat((force, wrench[:, 3:] - torch.linalg.cross(v, momentum)), dim=-1)
