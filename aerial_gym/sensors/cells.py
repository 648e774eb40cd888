"""The nearest distance in each cell of an image: an image as a few numbers, read once.

Letters: E environments, S sensors, H x W pixels, R x C cells.
"""

from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.interop import ReusableLaunch, launch_side_by_side, on_torch_stream, split, start_warp

BLOCK_DIM = 256  # Threads of a block on a GPU: eight cells, of which neighbours read the same sectors of memory
LANES = 32  # Threads that share a cell on a GPU, a warp; a cell that occupies fewer than half has one
ROWS = 6  # Rows of pixels that a thread on a GPU asks for before it waits for the first of them
MIN_PIXELS_PER_THREAD = 100_000  # Fewest pixels of a further CPU thread, whose hand-over takes some 50 µs


@wp.func_native("""
#if defined(__CUDA_ARCH__)
    for (int offset = 16; offset > 0; offset /= 2) value = min(value, __shfl_xor_sync(0xffffffff, value, offset));
#endif
    return value;
""")
def warp_minimum(value: float) -> float:
    """Return the least value among the lanes of a warp; on a CPU the value."""


@cache
def make_pooling_kernel(*, lanes: int, rows: int) -> wp.Kernel:
    """Return the kernel with ``lanes`` threads for a cell, a warp of a GPU or 1, that read ``rows`` rows of pixels at once."""

    @wp.kernel(module="unique", enable_backward=False)
    def pool(
        image: wp.array3d[float],  # (E, H, W), negative without a hit
        # params
        height: int,  # of a cell [pixels]
        width: int,
        largest: float,  # image value of 1, in the unit of the image
        empty: float,  # written where no pixel holds a distance
        first: int,  # environment of the first thread
        # out
        nearest_out: wp.array3d[float],  # (E, R, C)
    ):
        """Write the smallest distance of each cell as a share of the largest."""
        thread, row, column, lane = wp.tid()
        env = thread + first
        bottom = wp.min(image.shape[1], (row + 1) * height)
        right = wp.min(image.shape[2], (column + 1) * width)
        nearest = float(wp.inf)
        for top in range(row * height, bottom, wp.static(rows)):
            for x in range(column * width + lane, right, wp.static(lanes)):
                for k in range(wp.static(rows)):  # beyond the cell its last row again: nothing to decide before reading
                    distance = image[env, wp.min(top + k, bottom - 1), x]
                    nearest = wp.min(nearest, wp.where(distance >= 0.0, distance, wp.inf))
        if wp.static(lanes > 1):
            nearest = warp_minimum(nearest)
        if lane == 0:
            nearest_out[env, row, column] = wp.where(nearest < wp.inf, nearest / largest, empty)

    return pool


class NearestInCells:
    """Keeps the nearest distances of the first sensor's image, with all views made at construction."""

    def __init__(self, image: Tensor, *, cells: tuple[int, int], largest: float, empty: float) -> None:
        """Take a view of the image, which must keep its memory.

        Args:
            image: Distances, (E, S, H, W) float32, of which sensor 0 is read; negative without a hit.
            cells: Rows and columns of cells. Cells have equal size, rounded up; the last ones may be smaller.
            largest: Image value of 1, in the unit of the image.
        """
        if image.dim() != 4 or 0 in image.shape or image.dtype != torch.float32:
            raise ShapeError(f"image is {tuple(image.shape)} {image.dtype}, expected (E, S, H, W) torch.float32")
        start_warp()
        (rows, columns), (height, width) = cells, image.shape[2:]
        self.nearest = torch.full((image.shape[0], rows * columns), empty, device=image.device)
        """As a share of the largest, (E, R C), row by row from the upper left cell."""
        arrays = wp.from_torch(image[:, 0]), wp.from_torch(self.nearest.view(-1, rows, columns))
        size = -(-height // rows), -(-width // columns)
        lanes, together = _thread_layout(size, image.device)
        self._launches = [
            ReusableLaunch(
                make_pooling_kernel(lanes=lanes, rows=together),
                dim=(count, rows, columns, lanes),
                inputs=[arrays[0], *size, largest, empty, first],
                outputs=[arrays[1]],
                block_dim=BLOCK_DIM,
                device=image.device,
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


def _thread_layout(size: tuple[int, int], device: torch.device) -> tuple[int, int]:
    """Return the threads that share a cell of a size, height and width [pixels], and the rows that each reads at once."""
    if device.type != "cuda":
        return 1, 1
    return (LANES, ROWS) if size[1] > LANES // 2 else (1, min(ROWS, size[0]))
