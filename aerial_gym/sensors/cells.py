"""The nearest distance in each cell of an image: an image as a few numbers, read once.

Letters: E environments, S sensors, H x W pixels, R x C cells.
"""

from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.interop import launch_side_by_side, on_torch_stream, split, start_warp

BLOCK_DIM = 64
"""Threads that share a cell on a GPU: two rows of pixels at a time."""

COLUMNS = wp.constant(32)
"""Neighbouring pixels that are read at once."""

MIN_PIXELS_PER_THREAD = 100_000
"""Pixels below which another CPU thread costs more than it saves (a hand-over takes some 50 µs)."""


@cache
def make_pool(*, shared: bool) -> wp.Kernel:
    """Return the kernel; ``shared``: a block of threads takes a cell, rather than one thread (only on a GPU)."""

    @wp.kernel(module="unique", enable_backward=False)
    def pool(
        image: wp.array3d[float],  # (E, H, W), negative where there is no distance
        # params
        height: int,  # of a cell [pixels]
        width: int,
        largest: float,  # what counts as 1, in the unit of the image
        empty: float,  # written where no pixel holds a distance
        first: int,  # environment of the first block
        # out
        nearest_out: wp.array3d[float],  # (E, R, C)
    ):
        """Write the smallest distance of each cell as a share of the largest."""
        block, row, column, lane = wp.tid()
        env = block + first
        columns = wp.min(COLUMNS, wp.block_dim())
        bottom = wp.min(image.shape[1], (row + 1) * height)
        right = wp.min(image.shape[2], (column + 1) * width)
        nearest = float(wp.inf)
        for y in range(row * height + lane / columns, bottom, wp.block_dim() / columns):
            for x in range(column * width + lane % columns, right, columns):
                distance = image[env, y, x]
                if distance >= 0.0:
                    nearest = wp.min(nearest, distance)
        least = nearest
        if wp.static(shared):
            least = wp.tile_min(wp.tile(nearest))[0]
        if lane == 0:
            nearest_out[env, row, column] = wp.where(least < wp.inf, least / largest, empty)

    return pool


class NearestInCells:
    """Keeps the nearest distances of the first sensor's image, with all views made at construction."""

    def __init__(self, image: Tensor, *, cells: tuple[int, int], largest: float, empty: float) -> None:
        """Take a view of the image, which must stay where it is.

        Args:
            image: Distances, (E, S, H, W) float32, of which sensor 0 is read; negative where there is none.
            cells: Rows and columns of cells. Cells have equal size, rounded up; the last ones may be smaller.
            largest: What counts as 1, in the unit of the image.
            empty: The number of a cell in which no pixel holds a distance.

        Raises:
            ShapeError: If the image is no image.
        """
        if image.dim() != 4 or 0 in image.shape or image.dtype != torch.float32:
            raise ShapeError(f"image is {tuple(image.shape)} {image.dtype}, expected (E, S, H, W) torch.float32")
        start_warp()
        (rows, columns), (height, width) = cells, image.shape[2:]
        self.nearest = torch.full((image.shape[0], rows * columns), empty, device=image.device)
        """As a share of the largest, (E, R C), row by row from the upper left cell."""
        shared = image.device.type == "cuda"
        arrays = wp.from_torch(image[:, 0]), wp.from_torch(self.nearest.view(-1, rows, columns))
        size = -(-height // rows), -(-width // columns)
        self._kept_alive = (image, arrays)
        self._launches = [
            wp.launch_tiled(
                make_pool(shared=shared),
                dim=[count, rows, columns],
                inputs=[arrays[0], *size, largest, empty, first],
                outputs=[arrays[1]],
                block_dim=BLOCK_DIM if shared else 1,
                device=wp.device_from_torch(image.device),
                record_cmd=True,
            )
            for first, count in self._chunks(image)
        ]

    @staticmethod
    def _chunks(image: Tensor) -> list[tuple[int, int]]:
        """Return first environment and number of environments of each launch."""
        if image.device.type == "cuda":
            return [(0, len(image))]
        return split(len(image), min(torch.get_num_threads(), max(1, image[:, 0].numel() // MIN_PIXELS_PER_THREAD)))

    def measure(self) -> None:
        """Write the cells of the present image; launched on torch's current stream, not waited for."""
        with on_torch_stream(self.nearest):
            launch_side_by_side(self._launches)
