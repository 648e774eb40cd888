"""Path through a gate: its length, whose decrease is rewarded, and its direction.

Frames: a gate is flown through along its own x, its opening lies in its y and z. Letters: E environments.
"""

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate_inverse

WAY_AROUND = 0.6  # Radius of the way round a gate [m]: half a frame's diagonal, 0.51 m, and room for a vehicle
WAY_STRAIGHT = 0.4  # Length of the way along the axis of a gate [m]: the edge of its opening
AT_AXIS = 0.1  # Distance below which an axis has no direction [m]: a vehicle has 0.13 m in an opening of 0.4 m


def gate_path_length(position: Tensor, orientation: Tensor, robot: Tensor) -> Tensor:
    """Return the length of the path to a gate's centre from its front side [m], (E,).

    From the front it leads to a point on the gate's axis, ``WAY_STRAIGHT`` before it, and then along the axis; closer in,
    straight to the axis and along it. From behind it leads to the nearest point of a circle of radius ``WAY_AROUND`` around
    the gate, and from there to its centre. It is continuous except where the plane is crossed within the circle.
    Positions of gate and robot [m] are (E, 3), world; the orientation, gate to world, (E, 4).
    """
    x, y, z = quat_rotate_inverse(orientation, robot - position).unbind(-1)
    beside = (y * y + z * z).sqrt()
    straight = (-x).clamp(0.0, WAY_STRAIGHT)
    in_front = ((x + straight) ** 2 + beside * beside).sqrt() + straight
    around = (x * x + (beside - WAY_AROUND) ** 2).sqrt() + WAY_AROUND
    return torch.where(x <= 0.0, in_front, around)


def gate_path_direction(place: Tensor) -> Tensor:
    """Return the direction in which ``gate_path_length`` falls fastest, gate's frame, unit, (E, 3), at a position (E, 3) in it.

    Shorter than 1 within ``AT_AXIS`` of the gate's axis, or of the circle round it: nothing turns over there.
    """
    x, y, z = place.unbind(-1)
    beside = (y * y + z * z).sqrt()
    before = (x + WAY_STRAIGHT).clamp_max(0.0)  # of the point at which the straight way begins
    near = (x > -WAY_STRAIGHT).float()
    to_axis = (before * before + beside * beside).sqrt().clamp_min(AT_AXIS)
    in_front = torch.stack((near - before / to_axis, -y / to_axis, -z / to_axis), dim=-1)
    outward = (WAY_AROUND - beside) / beside.clamp_min(AT_AXIS)
    around = torch.stack((-x, outward * y, outward * z), dim=-1)
    toward = torch.where((x <= 0.0).unsqueeze(-1), in_front, around)
    return toward / (toward * toward).sum(-1, keepdim=True).sqrt().clamp_min(AT_AXIS)
