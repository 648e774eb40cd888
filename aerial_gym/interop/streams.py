"""Warp launches on torch's current stream, so that both see each other's work in order."""

from collections.abc import Iterator
from contextlib import contextmanager

import warp as wp
from torch import Tensor


@contextmanager
def on_torch_stream(tensor: Tensor) -> Iterator[None]:
    """Run the Warp launches inside on the torch stream of ``tensor``'s device; on the CPU there is nothing to join."""
    if tensor.device.type == "cuda":
        with wp.ScopedStream(wp.stream_from_torch(tensor.device)):
            yield
    else:
        yield
