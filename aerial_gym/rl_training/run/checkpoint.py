"""A checkpoint file: tensors, numbers and text, written whole, checked whole, read without running anything in it.

It is a zip archive of ``torch.save`` whose entries carry check sums; torch itself does not look at them.
"""

import io
import random
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.storage import write_whole
from aerial_gym.errors import ConfigError


def save(path: str | Path, payload: Mapping[str, object]) -> None:
    """Write nested mappings, sequences, tensors, numbers and text; a kill or a full disk leaves the old file as it was.

    Raises:
        StorageError: If it cannot be written.
    """
    memory = io.BytesIO()
    torch.save(dict(payload), memory)
    write_whole(path, memory.getvalue())


def load(path: str | Path) -> dict[str, Any]:
    """Return what ``save`` wrote, on the CPU.

    Raises:
        ConfigError: If there is no such file, it is damaged, or it holds anything but tensors, numbers and text.
    """
    path = Path(path)
    if not path.is_file():
        raise ConfigError(f"checkpoint {path}: no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            damaged = archive.testzip()
    except Exception:  # whatever a damaged archive makes the library raise
        raise ConfigError(f"checkpoint {path}: cannot be read, it is damaged or no checkpoint") from None
    if damaged is not None:
        raise ConfigError(f"checkpoint {path}: is damaged, the check sum of {damaged!r} is another")
    try:
        payload = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:  # torch's own text advises to run what the file holds
        raise ConfigError(
            f"checkpoint {path}: holds something other than tensors, numbers and text; it is not opened"
        ) from None
    if not isinstance(payload, dict):
        raise ConfigError(f"checkpoint {path}: must hold a mapping, found {type(payload).__name__}")
    return payload


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
    np.random.set_state((kind, _unsigned(keys), position, has_gauss, cached))
    version, words, gauss = state["python"]
    random.setstate((version, tuple(words), gauss))


def _unsigned(keys: Tensor) -> np.ndarray:
    return keys.numpy().astype(np.uint32)
