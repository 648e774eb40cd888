"""Rays in tiles: neighbouring pixels that are traced together, and the directions between which all rays of a tile lie.

Frame: the sensor's own. Letters: H x W = N pixels, T tiles, L rays of a tile.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

_MARGIN = 1e-5
"""Bounds of a tile are wider by this, so that rounding (6e-8) never rejects a hit."""


@dataclass(frozen=True, kw_only=True)
class Tiles:
    """A ray table in tile order; incomplete tiles are filled with copies of one ray."""

    direction: Tensor  # Unit directions, (T * L, 3)
    pixel: Tensor  # Pixel index of a ray, -1 for a copy, int32, (T * L,), in every frame
    middle: Tensor  # Middle of the directions of a tile, (T, 3)
    spread: Tensor  # Half of their spread on each axis, (T, 3)

    @property
    def num_tiles(self) -> int:
        """Number of tiles T."""
        return self.middle.shape[0]


def make_tiles(direction: Tensor, *, height: int, width: int) -> Tiles:
    """Return the tiles, ``height`` x ``width`` pixels each, of a ray table (H, W, 3)."""
    rows, columns = direction.shape[:2]
    down, across = -(-rows // height), -(-columns // width)
    index = torch.arange(rows * columns, device=direction.device).view(rows, columns)
    y = torch.arange(down * height, device=direction.device)
    x = torch.arange(across * width, device=direction.device)
    inside = (y < rows)[:, None] & (x < columns)
    nearest = index[y.clamp(max=rows - 1)[:, None], x.clamp(max=columns - 1)]

    def by_tile(image: Tensor) -> Tensor:
        return image.view(down, height, across, width).transpose(1, 2).reshape(down * across, height * width)

    source, real = by_tile(nearest), by_tile(inside)
    rays = direction.reshape(-1, 3)[source]
    low, high = rays.amin(dim=1), rays.amax(dim=1)
    return Tiles(
        direction=rays.reshape(-1, 3).contiguous(),
        pixel=torch.where(real, source, -1).reshape(-1).int().contiguous(),
        middle=0.5 * (low + high),
        spread=0.5 * (high - low) * (1.0 + _MARGIN) + _MARGIN,
    )


def stack_tiles(frames: Sequence[Tiles]) -> Tiles:
    """Return the concatenated tiles of several frames, with the pixels of the first."""
    parts = {name: torch.cat([getattr(tiles, name) for tiles in frames]) for name in ("direction", "middle", "spread")}
    return Tiles(pixel=frames[0].pixel, **parts)
