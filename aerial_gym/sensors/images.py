"""Images of a sensor as tensors and as kernel arrays, from the table ``config.images.IMAGES``; sample times and delay lines.

Letters: E environments, S sensors of one kind, M = E * S mounts, H x W = N pixels.
"""

from collections.abc import Iterator, Mapping
from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene_arrays import check_tensor
from aerial_gym.config.images import IMAGES, Image
from aerial_gym.config.sensor import RangeSensorCfg
from aerial_gym.errors import ShapeError
from aerial_gym.interop import ReusableLaunch, launch_side_by_side, on_torch_stream, split, start_warp
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.sensors.flow import Flow


class SensorImages(Mapping[str, Tensor]):
    """The tensors that a sensor writes, by their names in ``IMAGES``, which are attributes too: None for what it has not.

    Each is contiguous, (E, S, H, W) or with the components of a pixel behind, float32 or int32.
    """

    distance: Tensor  # Distances [m], or shares of max_range if the sensor normalises, float32, (E, S, H, W)

    def __init__(self, **images: Tensor | None) -> None:
        """Take the tensors; None stands for an image that the sensor has not."""
        self._images = {name: image for name, image in images.items() if image is not None}

    def __getitem__(self, name: str) -> Tensor:
        return self._images[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._images)

    def __len__(self) -> int:
        return len(self._images)

    def __getattr__(self, name: str) -> Tensor | None:
        if name not in IMAGES:
            raise AttributeError(f"a sensor has no image {name!r}. Known: {', '.join(IMAGES)}")
        return self._images.get(name)

    def check(self, cfg: RangeSensorCfg, num_envs: int, device: torch.device) -> None:
        """Raise ``ShapeError`` unless exactly the images that ``cfg`` asks for are here, and fit."""
        asked = sensor_images(cfg)
        for name in (*IMAGES, *self):
            if (name in self) != (name in asked):
                raise ShapeError(f"{name} must be given exactly if the sensor has such an image: it is {name in asked}")
        for name, image in self.items():
            shape = image_shape(cfg, asked[name], num_envs)
            check_tensor(name, image, shape, device=device, dtype=pixel_dtype(asked[name]))
            if not image.is_contiguous():
                raise ShapeError(f"{name} has stride {image.stride()}: images must be contiguous")


def sensor_images(cfg: RangeSensorCfg) -> dict[str, Image]:
    """Return the rows of ``IMAGES`` that a sensor has."""
    return {name: image for name, image in IMAGES.items() if image.is_enabled(cfg)}


def pixel_dtype(image: Image) -> torch.dtype:
    """Return the dtype of an image's pixels."""
    return torch.int32 if image.ids else torch.float32


def image_shape(cfg: RangeSensorCfg, image: Image, num_envs: int) -> tuple[int, ...]:
    """Return the shape of an image, (E, S, H, W), or (E, S, H, W, C) with C > 1 components."""
    more = () if image.components == 1 else (image.components,)
    return (num_envs, cfg.count, cfg.height, cfg.width, *more)


POISON = {torch.float32: float("nan"), torch.int32: -(2**31)}  # Pixels that no kernel writes, by dtype


def make_images(cfg: RangeSensorCfg, num_envs: int, *, device: torch.device, poisoned: bool = False) -> SensorImages:
    """Return new images of a sensor, full of zeros, or of ``POISON``."""
    images = {}
    for name, image in sensor_images(cfg).items():
        shape, dtype = image_shape(cfg, image, num_envs), pixel_dtype(image)
        images[name] = torch.full(shape, POISON[dtype] if poisoned else 0, dtype=dtype, device=device)
    return SensorImages(**images)


def declare_images(
    gtd: GlobalTensorDictionary, cfg: RangeSensorCfg, shape: tuple[str | int, ...], *, prefix: str, owner: str
) -> SensorImages:
    """Declare the images of a sensor, with a prefix in front of their keys, and return them; ``shape`` is (E, S, H, W)."""
    return SensorImages(**{
        name: gtd.declare(TensorSpec(
            key=f"{prefix}{image.key}",
            shape=shape if image.components == 1 else (*shape, image.components),
            dtype=pixel_dtype(image),
            unit=image.resolve_unit(cfg),
            frame=image.resolve_frame(cfg),
            owner=owner,
            meaning=image.resolve_meaning(cfg),
        ))
        for name, image in sensor_images(cfg).items()
    })  # fmt: skip


_PIXEL = {1: wp.float32, 2: wp.vec2, 3: wp.vec3}  # Type of a pixel by the number of its components


def _pixel_type(image: Image) -> type:
    return wp.int32 if image.ids else _PIXEL[image.components]


@cache
def arrays_type(names: tuple[str, ...]) -> type:
    """Return the struct type for a kernel that writes these images, each (M, N)."""
    needed = {
        "semantic_id": wp.array2d[wp.int32],  # (E, P) of the scene
        "origin": wp.array[wp.vec3],  # (M,) of the sensor, world [m]; of a turning lidar (M * G,), for every seat
        "attitude": wp.array[wp.quat],  # (M,) sensor to world; likewise
        "flow": Flow,
    }
    written = {name: wp.array2d[_pixel_type(IMAGES[name])] for name in names}
    return wp.struct(type("Images", (), {"__annotations__": {**needed, **written}, "__module__": __name__}))


def make_arrays(images: SensorImages) -> object:
    """Return the struct of these images; its other members are set later."""
    arrays = arrays_type(tuple(images))()
    for name, image in images.items():
        pixels = image.shape[2] * image.shape[3]
        view = image.view(-1, pixels, *image.shape[4:])
        setattr(arrays, name, wp.from_torch(view, dtype=_pixel_type(IMAGES[name])))
    return arrays


CLOCK_MARGIN = 1e-4  # Share of a period by which a measurement may be early: float32 sums of steps are not exact


def latency_steps(latency_s: float, dt: float) -> int:
    """Return a latency in steps of ``dt`` [s], rounded to a whole number."""
    return round(latency_s / dt)


class DelayLine:
    """Keeps the last images of a sensor and gives out the oldest; an environment starts with its first image at every age."""

    def __init__(self, fresh: SensorImages, out: SensorImages, steps: int) -> None:
        """Take the sensor's images, the delayed images, and the delay in steps, >= 1."""
        self._pairs: list[tuple[Tensor, Tensor, list[Tensor]]] = []
        for name, image in fresh.items():
            self._pairs.append((image, out[name], [torch.zeros_like(image) for _ in range(steps)]))
        like = fresh.distance
        self._started = torch.zeros(like.shape[0], dtype=torch.bool, device=like.device)

    def push_images(self, mask: Tensor | None = None) -> None:
        """Output the images of ``steps`` calls ago and store the present ones, without waiting.

        With a mask, bool (E,), the other environments stay as they are.
        """
        for fresh, out, kept in self._pairs:
            tail = [1] * (fresh.dim() - 1)
            started, rows = self._started.view(-1, *tail), None if mask is None else mask.view(-1, *tail)

            def write(target: Tensor, image: Tensor, rows: Tensor | None = rows) -> None:
                target.copy_(image if rows is None else torch.where(rows, image, target))

            write(out, torch.where(started, kept[-1], fresh))
            for older, newer in zip(reversed(kept[1:]), reversed(kept[:-1]), strict=True):
                write(older, torch.where(started, newer, fresh))
            write(kept[0], fresh)
        if mask is None:
            self._started.fill_(True)
        else:
            self._started.logical_or_(mask)

    def state_tensors(self) -> dict[str, Tensor]:
        """Return the tensors of a saved state, by name."""
        kept = {f"{i}.{age}": image for i, (_, _, ages) in enumerate(self._pairs) for age, image in enumerate(ages)}
        return {"started": self._started, **kept}

    def reset(self, mask: Tensor) -> None:
        """Forget the images of the environments in ``mask``, bool (E,)."""
        self._started.logical_and_(~mask)


def zero_images_like(images: SensorImages) -> SensorImages:
    """Return images of the same shapes."""
    return SensorImages(**{name: torch.zeros_like(image) for name, image in images.items()})


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
