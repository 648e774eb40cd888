"""State of a vehicle and its surroundings in which effects evaluate their forces.

Frames: body is x forward, y left, z up; world is z up. Letters: E environments, R rotors.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isnan
from typing import Any

import torch
from torch import Tensor

from aerial_gym.math.quaternion import world_up
from aerial_gym.math.rows import dot, sum_slices, times
from aerial_gym.physics.rotors import rotor_torque
from aerial_gym.physics.vehicle import Vehicle, is_shared


class _MotionProperty(cached_property):
    """Quantity of the motion, computed once for all conditions that share the motion."""

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        """Return the quantity."""
        if instance is None:
            return self
        shared = vars(instance).setdefault("_motion", {})
        if self.attrname not in shared:
            shared[self.attrname] = self.func(instance)
        return shared[self.attrname]


@dataclass(frozen=True, kw_only=True)
class Condition:
    """State of a vehicle and its surroundings at one instant."""

    position: Tensor  # Centre of mass [m], world, (E, 3)
    attitude: Tensor  # Body to world, xyzw, (E, 4)
    air_velocity: Tensor  # Velocity of the centre of mass through the air [m/s], body axes, (E, 3)
    ang_vel: Tensor  # Angular velocity [rad/s], body, (E, 3)
    rotor_speed: Tensor  # Rotor speeds [rad/s], (E, R)
    rotor_thrust: Tensor  # Rotor thrusts [N], (E, R)
    rotor_acc: Tensor  # Angular accelerations of the rotors, positive where they speed up [rad/s²], (E, R)
    ground_height: float | Tensor  # Height of the ground [m], world; or (E, 1)
    ceiling_height: float | Tensor  # Height of the ceiling [m], world; not a number where there is none; or (E, 1)
    other_position: Tensor  # Another vehicle, whose wake streams down [m], world, (E, 3)
    vehicle: Vehicle  # Gives the geometry

    @_MotionProperty
    def lever(self) -> Tensor:
        """Hubs from the centre of mass [m], body, (E, R, 3); (1, R, 3) where all environments have the same."""
        return self.vehicle.rotor_lever

    @_MotionProperty
    def axis(self) -> Tensor:
        """Directions of thrust, body, (E, R, 3); (1, R, 3) where all environments have the same."""
        axis = self.vehicle.rotor_axis
        return axis[:1] if is_shared(axis) else axis

    @_MotionProperty
    def hub_velocity(self) -> Tensor:
        """Velocity of the hubs through the air [m/s], body, (E, R, 3): ``v + w x l``, in the wind at the centre of mass."""
        return self.air_velocity.unsqueeze(1) + velocity_of_turning(self.ang_vel, self.lever)

    @_MotionProperty
    def up(self) -> Tensor:
        """World z in body axes, (E, 3)."""
        return world_up(self.attitude)

    @_MotionProperty
    def hub_altitude(self) -> Tensor:
        """World z of the hubs [m], (E, R)."""
        return self.position[:, 2:] + dot(self.lever, self.up.unsqueeze(1))

    @_MotionProperty
    def axis_height(self) -> Tensor:
        """World z of the directions of thrust, -1 to 1, (E, R)."""
        return dot(self.axis, self.up.unsqueeze(1))

    @property
    def wake_room(self) -> Tensor:
        """Distance of the hubs to the surface in their wakes [m], (E, R): the ground, or the ceiling if thrust is downward."""
        return torch.where(self._wake_goes_up, self._ceiling_clearance, self._ground_clearance)

    @property
    def inlet_room(self) -> Tensor:
        """Distance from the hubs to the surface above their inlets [m], (E, R): the ceiling, or the ground likewise."""
        return torch.where(self._wake_goes_up, self._ground_clearance, self._ceiling_clearance)

    @property
    def _wake_goes_up(self) -> Tensor:
        return self.rotor_thrust * self.axis_height < 0.0

    @_MotionProperty
    def _ground_clearance(self) -> Tensor:
        return self.hub_altitude - self.ground_height

    @_MotionProperty
    def _ceiling_clearance(self) -> Tensor:
        ceiling = self.ceiling_height
        if isinstance(ceiling, Tensor):
            ceiling = torch.where(ceiling.isnan(), inf, ceiling)
        elif isnan(ceiling):
            ceiling = inf
        return ceiling - self.hub_altitude

    @cached_property
    def rotor_drag_torque(self) -> Tensor:
        """Drag torques against the spin of the rotors [N m], (E, R); those of reversed rotors are negative."""
        return rotor_torque(self.vehicle, self.rotor_speed)

    @_MotionProperty
    def axial_velocity(self) -> Tensor:
        """Velocity of the hubs through the air along their rotors' axes [m/s], (E, R)."""
        return dot(self.hub_velocity, self.axis)

    @_MotionProperty
    def edgewise_velocity(self) -> Tensor:
        """Velocity of the hubs through the air in the planes of their rotors [m/s], body, (E, R, 3)."""
        return self.hub_velocity - self.axial_velocity.unsqueeze(-1) * self.axis

    def with_thrust(self, thrust: Tensor) -> "Condition":
        """Return the condition with other thrusts [N], (E, R); cached quantities of the motion are kept."""
        return self._with_cached_motion(replace(self, rotor_thrust=thrust))

    def of_vehicle(self, vehicle: Vehicle, thrust: Tensor) -> "Condition":
        """Return the condition of a vehicle of the same centre of mass and hubs, with its thrusts [N], (E, R)."""
        if vehicle is self.vehicle:
            return self
        return self._with_cached_motion(replace(self, vehicle=vehicle, rotor_thrust=thrust))

    def _with_cached_motion(self, other: "Condition") -> "Condition":
        """Return another condition of the same motion, which shares the cached quantities of the motion."""
        vars(other)["_motion"] = vars(self).setdefault("_motion", {})
        return other


def velocity_of_turning(ang_vel: Tensor, lever: Tensor) -> Tensor:
    """Return ``w x l``, (E, R, 3), for w (E, 3) and l (E, R, 3) or, shared, (1, R, 3); rows do not depend on E."""
    if not is_shared(lever):
        return torch.linalg.cross(ang_vel.unsqueeze(1), lever, dim=-1)
    return times(ang_vel, _unit_turns(lever[0]).transpose(0, 1).reshape(3, -1)).view(-1, lever.shape[1], 3)


def sum_of_crosses(vector: Tensor, arm: Tensor) -> Tensor:
    """Return ``sum_r v_r x a_r``, (E, 3), for vectors v (E, R, 3) and arms a (E, R, 3) or, shared, (1, R, 3)."""
    if not is_shared(arm):
        return sum_slices(torch.linalg.cross(vector, arm, dim=-1), 1)
    return times(vector.flatten(1), _unit_turns(arm[0]).reshape(-1, 3))


def _unit_turns(arm: Tensor) -> Tensor:
    """Return ``e_k x a`` in row k, (R, 3, 3), for arms a (R, 3)."""
    x, y, z = arm.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), dim=-1).view(-1, 3, 3)
