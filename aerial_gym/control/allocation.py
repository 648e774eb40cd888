"""From a wanted body wrench to rotor commands.

The matrix is derived from the rotors of the *declared* vehicle: an autopilot does not know the effects it lacks.
Frames: body is x forward, y left, z up. Letters: E environments, R rotors.
"""

import torch
from torch import Tensor

from aerial_gym.physics.rotors import evaluate_map, speed_for_thrust
from aerial_gym.physics.vehicle import Vehicle, is_shared, share_row


def allocation_matrix(vehicle: Vehicle, gravity: float) -> Tensor:
    """Return the matrix that maps rotor thrusts to force and torque about the centre of mass, (E, 6, R).

    A column is ``[a; (r - c) x a - s k a]`` with axis a, hub r, centre of mass c, spin s and torque per thrust k, taken
    at the hover thrust ``m g / R`` where the two polynomials are not proportional.

    Source:
        Mahony, Kumar, Corke (2012), Multirotor Aerial Vehicles, eq. 8, for arbitrary axes.
    """
    hover = (vehicle.mass * gravity / vehicle.num_rotors).unsqueeze(-1).expand(-1, vehicle.num_rotors)
    speed = speed_for_thrust(vehicle.thrust_map, hover)
    torque_ratio = evaluate_map(vehicle.torque_map, speed) / evaluate_map(vehicle.thrust_map, speed)
    lever = vehicle.rotor_position - vehicle.com.unsqueeze(1)
    reaction = (vehicle.rotor_spin * torque_ratio).unsqueeze(-1) * vehicle.rotor_axis
    torque = torch.linalg.cross(lever, vehicle.rotor_axis) - reaction
    return torch.cat((vehicle.rotor_axis, torque), dim=-1).transpose(1, 2)


class Allocation:
    """Pseudo-inverse allocation with clamping to the rotors' limits."""

    def __init__(self, vehicle: Vehicle, gravity: float) -> None:
        """Take the declared vehicle and gravity [m/s²]."""
        matrix = allocation_matrix(vehicle, gravity)
        limits = (evaluate_map(vehicle.thrust_map, speed) for speed in (vehicle.speed_low, vehicle.speed_high))
        self.thrust_map = vehicle.thrust_map
        if is_shared(vehicle.mass):  # a declared vehicle is the same everywhere
            self.inverse = share_row(torch.linalg.pinv(matrix[0]), vehicle.num_envs)  # (E, R, 6)
            self.low, self.high = (share_row(limit[0], vehicle.num_envs) for limit in limits)
        else:
            self.inverse, (self.low, self.high) = torch.linalg.pinv(matrix), limits

    def thrust(self, wrench: Tensor) -> Tensor:
        """Return unclamped rotor thrusts [N], (E, R), of least norm for a wrench [N, N m], body, (E, 6)."""
        return (self.inverse * wrench.unsqueeze(1)).sum(-1)

    def speed(self, thrust: Tensor) -> Tensor:
        """Return rotor speeds [rad/s], (E, R), that give the thrusts [N] after clamping to the limits."""
        return speed_for_thrust(self.thrust_map, torch.clamp(thrust, self.low, self.high))
