"""Random states that are the same everywhere: from the bits of a generator, by operations that IEEE 754 rounds exactly."""

import argparse
import ctypes
from collections.abc import Callable, Mapping
from pathlib import Path
from zlib import crc32

import numpy as np
import torch
from numpy.typing import NDArray

Array = NDArray[np.float32]


class Draws:
    """Numbers of one stream."""

    def __init__(self, seed: int) -> None:
        self._bits = np.random.PCG64(seed)

    def __call__(self, *shape: int, low: float = -1.0, high: float = 1.0) -> Array:
        """Return numbers between two ends, float32, of a shape."""
        share = (self._bits.random_raw(int(np.prod(shape))) >> np.uint64(40)).astype(np.float32) / np.float32(2**24)
        return (np.float32(low) + np.float32(high - low) * share.reshape(shape)).astype(np.float32)

    def unit_quaternions(self, *shape: int, upright: float = 0.0) -> Array:
        """Return unit quaternions (..., 4), scalar last; the more upright, the smaller the turns."""
        q = self(*shape, 4)
        q[..., 3] += np.float32(upright)
        square = q[..., 0] * q[..., 0] + q[..., 1] * q[..., 1] + q[..., 2] * q[..., 2] + q[..., 3] * q[..., 3]
        return q / np.sqrt(square)[..., None]


def checksum(*arrays: Array) -> int:
    return crc32(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))


def pointer(array: Array) -> ctypes.c_void_p:
    """Return the C pointer to the data of a contiguous float32 array."""
    assert array.dtype == np.float32
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)


def write_vectors(
    summary: str, source: str, out: Path, answers: Callable[[Path], Mapping[str, Array]], states: int
) -> None:
    """Write the answers of a firmware and the checksum of the states; its place is the option named ``source``."""
    parser = argparse.ArgumentParser(description=summary.splitlines()[0])
    parser.add_argument(f"--{source}", dest="place", type=Path, required=True, help="where the firmware is")
    parser.add_argument("--version", default="", help="which version that is, to be written beside the numbers")
    parser.add_argument("--out", type=Path, default=out)
    args = parser.parse_args()
    np.savez_compressed(args.out, checksum=states, version=args.version, **answers(args.place))


def load_vectors(path: Path, states: int) -> dict[str, torch.Tensor]:
    """Return the answers of a firmware by name, if they are those to these states."""
    with np.load(path) as file:
        if int(file["checksum"]) != states:
            raise ValueError(f"the random states are not those of {path.name}: make the vectors anew ({path.stem}.py)")
        return {
            name: torch.from_numpy(file[name]).double() for name in file.files if name not in ("checksum", "version")
        }
