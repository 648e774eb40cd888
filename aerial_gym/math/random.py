"""Random draws from a generator that is passed in."""

import torch
from torch import Tensor


def uniform(low: Tensor, high: Tensor, shape: tuple[int, ...], *, generator: torch.Generator) -> Tensor:
    """Return uniform draws between ``low`` and ``high``, which broadcast to ``shape``; same dtype and device."""
    draw = torch.rand(shape, dtype=low.dtype, device=low.device, generator=generator)
    return low + (high - low) * draw
