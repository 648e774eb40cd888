"""A checkpoint file (an archive of ``config.storage``), and the states of the global random generators for it."""

import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.storage import read_archive, write_archive


def save(path: str | Path, payload: Mapping[str, object]) -> None:
    """Write a checkpoint as an archive (``write_archive``)."""
    write_archive(path, payload)


def load(path: str | Path) -> dict[str, Any]:
    """Return the content of a checkpoint, see ``read_archive``."""
    return read_archive(path, "checkpoint")


def random_state() -> dict[str, object]:
    """Return the states of the global generators of torch, CUDA, NumPy and Python, ready for ``save``."""
    kind, keys, position, has_gauss, cached = np.random.get_state()
    return {
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if torch.cuda.is_available() else [],
        "numpy": [str(kind), torch.from_numpy(np.asarray(keys).astype(np.int64)), position, has_gauss, cached],
        "python": random.getstate(),
    }


def restore_random_state(state: Mapping[str, Any]) -> None:
    """Continue the global generators where ``random_state`` found them; GPUs only on a machine with as many."""
    torch.set_rng_state(state["torch"])
    if state["cuda"] and torch.cuda.is_available() and len(state["cuda"]) == torch.cuda.device_count():
        torch.cuda.set_rng_state_all(state["cuda"])
    kind, keys, position, has_gauss, cached = state["numpy"]
    np.random.set_state((kind, _keys_as_uint32(keys), position, has_gauss, cached))
    version, words, gauss = state["python"]
    random.setstate((version, tuple(words), gauss))


def _keys_as_uint32(keys: Tensor) -> np.ndarray:
    return keys.numpy().astype(np.uint32)
