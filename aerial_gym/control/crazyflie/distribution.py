"""From the counts of the Crazyflie's controllers to its rotors: four of them, in an X.

Every rotor is told the thrust, and of the moments half of roll and pitch and all of yaw, up or down by where it stands and how
it turns. Where one is told more than there is, all give way alike, so that the moments stay; less than nothing is nothing.
A rotor gives of its largest thrust the share that its counts are of all.
Letters: E environments, R rotors.
Source: what the firmware's power distribution answers (``tests/cross/firmware``); of more than there is
its change 1147 (github.com/bitcraze/crazyflie-firmware) says that attitude comes before thrust.
"""

import torch
from torch import Tensor

from aerial_gym.control.allocation import Allocation
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.errors import ConfigError
from aerial_gym.physics.vehicle import Vehicle

MOST_COUNTS = 65535.0
"""All that a rotor can be told."""

SHARES = (0.5, 0.5, 1.0)
"""Of the moments about x, y and z that each rotor is told."""


def require_position(law: str) -> None:
    """Raise ``ConfigError`` for laws that the Crazyflie's controllers do not have here."""
    if law != "position":
        raise ConfigError(f"law {law!r}: the Crazyflie's controllers fly to a position. Take law: position")


def signs_of(law: str, vehicle: Vehicle, allocation: Allocation, gravity: float) -> Tensor:
    """Return which way each rotor turns the vehicle about x, y and z by its thrust, 1 or -1, (R, 3).

    Raises:
        ConfigError: If the vehicle is not one of four rotors in an X that all push up and turn one way.
    """
    refused = f"law {law!r}: the Crazyflie has four rotors in an X that are told a share of their thrust"
    instead = "Take lee_position_control"
    if kinds := vehicle.traits & {"reversible", "force"}:
        raise ConfigError(
            f"{refused}, and rotors of this vehicle are of another kind ({', '.join(sorted(kinds))}). {instead}"
        )
    if vehicle.num_rotors != 4 or bool((allocation.inverse[0, :, 2] <= 0.0).any()):
        raise ConfigError(
            f"{refused}, and this vehicle has {vehicle.num_rotors} rotors, or some do not push up. {instead}"
        )
    signs = torch.sign(allocation_matrix(vehicle, gravity)[0, 3:].T.detach())
    if not torch.equal(signs.T @ signs, 4.0 * torch.eye(3, dtype=signs.dtype, device=signs.device)):
        raise ConfigError(
            f"{refused}, and the four of this vehicle do not turn it about each axis as those do. {instead}"
        )
    return signs


def told(thrust: Tensor, moment: Tensor, signs: Tensor) -> Tensor:
    """Return the counts of each rotor, (E, R), for a thrust (E, 1) and moments (E, 3), all in counts."""
    parts = moment * moment.new_tensor(SHARES)
    counts = thrust + parts @ signs.to(moment).T
    excess = (counts.amax(-1, keepdim=True) - MOST_COUNTS).clamp_min(0.0)
    return (counts - excess).clamp_min(0.0)


def torque_per_count(vehicle: Vehicle, allocation: Allocation, signs: Tensor, gravity: float) -> Tensor:
    """Return the torque [N m] that one count of moment about each body axis is worth, (3,)."""
    thrust = signs * signs.new_tensor(SHARES) * (allocation.high[0] / MOST_COUNTS).unsqueeze(-1)
    return (allocation_matrix(vehicle, gravity)[0, 3:] @ thrust).diagonal()
