"""Helpers of the Aerial Gym Simulator's scripts, by their names; ours where there is one.

Quaternions are xyzw, body to world; angles are radians; any leading shape unless said otherwise.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from aerial_gym.math.quaternion import (
    euler_from_quat,
    quat_conjugate,
    quat_from_euler,
    quat_multiply,
    quat_normalize,
    quat_rotate,
    quat_rotate_inverse,
    quat_to_matrix,
    quat_without_tilt,
    wrap_angle,
)

__all__ = [
    "compute_vee_map", "copysign", "exponential_penalty_function", "exponential_reward_function", "get_euler_xyz",
    "get_euler_xyz_tensor", "matrix_to_euler_zyx", "normalize", "pd_control", "quat_apply", "quat_apply_inverse",
    "quat_axis", "quat_conjugate", "quat_from_euler_xyz", "quat_from_euler_xyz_tensor", "quat_inverse", "quat_mul",
    "quat_rotate", "quat_rotate_inverse", "quat_to_rotation_matrix", "quat_unit", "ssa", "tensor_clamp", "to_torch",
    "torch_interpolate_ratio", "torch_rand_float", "torch_rand_float_tensor", "vehicle_frame_quat_from_quat",
]  # fmt: skip

quat_mul = quat_multiply
quat_inverse = quat_conjugate
quat_unit = quat_normalize
quat_apply = quat_rotate
quat_apply_inverse = quat_rotate_inverse
quat_to_rotation_matrix = quat_to_matrix
quat_from_euler_xyz_tensor = quat_from_euler
vehicle_frame_quat_from_quat = quat_without_tilt


def get_euler_xyz_tensor(q: Tensor) -> Tensor:
    """Return ZYX roll, pitch, yaw [rad], (..., 3), roll and yaw in (-pi, pi]; there in [0, 2 pi), which ``ssa`` undoes."""
    return euler_from_quat(q)


def get_euler_xyz(q: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return roll, pitch and yaw [rad] of quaternions as three tensors (...,)."""
    roll, pitch, yaw = euler_from_quat(q).unbind(-1)
    return roll, pitch, yaw


def quat_from_euler_xyz(roll: Tensor, pitch: Tensor, yaw: Tensor) -> Tensor:
    """Return the quaternion of ZYX Euler angles [rad], (..., 4)."""
    return quat_from_euler(torch.stack((roll, pitch, yaw), dim=-1))


def matrix_to_euler_zyx(matrix: Tensor) -> Tensor:
    """Return yaw, pitch, roll [rad] of a rotation matrix (..., 3, 3), in this order as pytorch3d's ``"ZYX"``, (..., 3)."""
    yaw = torch.atan2(matrix[..., 1, 0], matrix[..., 0, 0])
    pitch = torch.asin((-matrix[..., 2, 0]).clamp(-1.0, 1.0))
    roll = torch.atan2(matrix[..., 2, 1], matrix[..., 2, 2])
    return torch.stack((yaw, pitch, roll), dim=-1)


def quat_axis(q: Tensor, axis: int = 0) -> Tensor:
    """Return a body axis (0 x, 1 y, 2 z) in the world, (..., 3)."""
    unit = torch.zeros_like(q[..., :3])
    unit[..., axis] = 1.0
    return quat_rotate(q, unit)


def compute_vee_map(skew_matrix: Tensor) -> Tensor:
    """Return the vector v of a skew-symmetric matrix [v]x, (..., 3)."""
    return torch.stack((-skew_matrix[..., 1, 2], skew_matrix[..., 0, 2], -skew_matrix[..., 0, 1]), dim=-1)


def ssa(angle: Tensor) -> Tensor:
    """Return angles [rad] in [-pi, pi)."""
    return wrap_angle(angle)


def normalize(x: Tensor, eps: float = 1e-9) -> Tensor:
    """Return ``x / max(|x|, eps)`` along the last dimension."""
    return x / x.norm(dim=-1, keepdim=True).clamp(min=eps)


def copysign(a: float, b: Tensor) -> Tensor:
    """Return ``|a|`` with the signs of ``b``."""
    return torch.full_like(b, abs(a)) * torch.where(b < 0.0, -1.0, 1.0)


def pd_control(pos_error: Tensor, vel_error: Tensor, stiffness: Tensor | float, damping: Tensor | float) -> Tensor:
    """Return ``stiffness pos_error + damping vel_error``."""
    return stiffness * pos_error + damping * vel_error


def tensor_clamp(t: Tensor, min_t: Tensor, max_t: Tensor) -> Tensor:
    """Return ``t`` within limits that are tensors."""
    return torch.minimum(torch.maximum(t, min_t), max_t)


def to_torch(
    x: object, dtype: torch.dtype = torch.float32, device: str | torch.device = "cpu", requires_grad: bool = False
) -> Tensor:
    """Return a new tensor of numbers, on the CPU by default; that simulator's default is the first GPU."""
    return torch.tensor(x, dtype=dtype, device=device, requires_grad=requires_grad)


def torch_rand_float_tensor(lower: Tensor, upper: Tensor) -> Tensor:
    """Return numbers drawn uniformly between tensors of limits by torch's own generator, of their shape."""
    return lower + (upper - lower) * torch.rand_like(upper)


def torch_rand_float(lower: float, upper: float, shape: Sequence[int], device: str | torch.device) -> Tensor:
    """Return numbers drawn uniformly between two limits by torch's own generator."""
    return lower + (upper - lower) * torch.rand(*shape, device=device)


def torch_interpolate_ratio(min: Tensor, max: Tensor, ratio: Tensor) -> Tensor:
    """Return ``min + (max - min) ratio``; a ratio may have more columns, of which the first ones count."""
    return min + (max - min) * ratio[..., : min.shape[-1]]


def exponential_reward_function(magnitude: float, exponent: float, value: Tensor) -> Tensor:
    """Return ``magnitude exp(-exponent value²)``."""
    return magnitude * torch.exp(-exponent * value * value)


def exponential_penalty_function(magnitude: float, exponent: float, value: Tensor) -> Tensor:
    """Return ``magnitude (exp(-exponent value²) - 1)``, which is never positive."""
    return magnitude * (torch.exp(-exponent * value * value) - 1.0)
