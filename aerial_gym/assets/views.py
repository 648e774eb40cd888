"""Warp views of torch tensors, made once at construction and kept."""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError


def check_tensor(
    name: str, tensor: Tensor, shape: tuple[int, ...], *, device: torch.device, dtype: torch.dtype = torch.float32
) -> None:
    """Raise ``ShapeError`` unless a tensor has this shape, dtype and device; ``cuda`` matches any index."""
    same_device = tensor.device.type == device.type and device.index in (None, tensor.device.index)
    if tuple(tensor.shape) != shape or tensor.dtype != dtype or not same_device:
        raise ShapeError(
            f"{name} is {tuple(tensor.shape)} {tensor.dtype} on {tensor.device}, expected {shape} {dtype} on {device}"
        )


def vector_view(name: str, tensor: Tensor, shape: tuple[int, ...], *, device: torch.device) -> wp.array:
    """Return a Warp array of vectors (last axis 3) or quaternions (4) on the memory of a tensor strided in other axes."""
    check_tensor(name, tensor, shape, device=device)
    if tensor.stride(-1) != 1:
        raise ShapeError(f"{name} has stride {tensor.stride()}: the last axis must be contiguous")
    return wp.from_torch(tensor, dtype=wp.vec3 if shape[-1] == 3 else wp.quat)
