"""The Crazyflie's power distribution: from thrust and moments in counts to four rotors in an X.

Each rotor gets the thrust, plus or minus half of the roll and pitch moments and all of the yaw moment, by its position and
spin. If one exceeds the maximum, all are reduced alike, which preserves the moments; negative counts become 0. A rotor's share
of its largest thrust is its share of the largest counts.
Letters: E environments, R rotors.
Source: outputs of the firmware's power distribution (``tests/cross/firmware``); attitude has priority over thrust by its
change 1147 (github.com/bitcraze/crazyflie-firmware).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.control.allocation import Allocation
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.errors import ConfigError
from aerial_gym.physics.vehicle import Vehicle

MOST_COUNTS = 65535.0  # Largest command of a rotor [counts]
SHARES = (0.5, 0.5, 1.0)  # Shares of the moments about x, y and z in each rotor's command


def require_position(law: str) -> None:
    """Raise ``ConfigError`` unless the law is position control."""
    if law != "position":
        raise ConfigError(f"law {law!r}: the Crazyflie's controllers control position only. Take law: position")


def rotor_signs(law: str, vehicle: Vehicle, allocation: Allocation, gravity: float) -> Tensor:
    """Return the signs of each rotor's torque about x, y and z, 1 or -1, (R, 3).

    Raises:
        ConfigError: Unless the vehicle has four rotors in an X that all push up and turn in one direction.
    """
    refused = f"law {law!r}: the Crazyflie has four rotors in an X that take a share of their thrust"
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


def rotor_counts(thrust: Tensor, moment: Tensor, signs: Sequence[Sequence[float]]) -> Tensor:
    """Return the counts of each rotor, (E, R), for a thrust (E, 1) and moments (E, 3), all in counts.

    Args:
        signs: Those of ``rotor_signs``, as numbers.
    """
    parts = moment * moment.new_tensor(SHARES)
    counts = thrust + (parts.unsqueeze(1) * moment.new_tensor(signs)).sum(-1)
    excess = (counts.amax(-1, keepdim=True) - MOST_COUNTS).clamp_min(0.0)
    return (counts - excess).clamp_min(0.0)


def torque_per_count(vehicle: Vehicle, allocation: Allocation, signs: Tensor, gravity: float) -> Tensor:
    """Return the torque [N m] of one count of moment about each body axis, (3,)."""
    thrust = signs * signs.new_tensor(SHARES) * (allocation.high[0] / MOST_COUNTS).unsqueeze(-1)
    return (allocation_matrix(vehicle, gravity)[0, 3:] @ thrust).diagonal()
