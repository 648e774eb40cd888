"""What effects on a single rotor share: which one it is."""

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import Parameter
from aerial_gym.physics.vehicle import Vehicle

MOST_ROTORS = 64

ROTOR = Parameter(
    name="motor", unit="-", low=1, high=MOST_ROTORS, scale=1.0, meaning="which rotor, from 1 on", kind="rotor"
)


def chosen_rotor(vehicle: Vehicle, motor: Tensor) -> Tensor:
    """Return 1 at the rotor that ``motor`` (E,), counted from 1, names, and 0 elsewhere, (E, R)."""
    numbers = torch.arange(1, vehicle.num_rotors + 1, device=motor.device)
    return (numbers == motor.round().unsqueeze(1)).to(vehicle.rotor_spin.dtype)
