"""Findings as JSON has them."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np


def plain(value: object) -> object:
    """Return a value as JSON has it, through all levels: what has a mapping of its own by that, arrays and tuples as lists."""
    if hasattr(value, "as_mapping"):
        return value.as_mapping()  # type: ignore[union-attr]
    if isinstance(value, Mapping):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def fields_of(found: object, *names: str) -> dict[str, object]:
    """Return some fields of a finding by their names, as JSON has them."""
    return {name: plain(getattr(found, name)) for name in names}


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write a file of JSON for programs and people; numbers that are none are refused."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")
