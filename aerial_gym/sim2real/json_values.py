"""Conversion of results to JSON."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np


def plain(value: object) -> object:
    """Return a JSON value, recursively: ``as_mapping`` of objects, lists for arrays and tuples."""
    if hasattr(value, "as_mapping"):
        return value.as_mapping()  # type: ignore[union-attr]
    if isinstance(value, Mapping):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, tuple | list):
        return [plain(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def select_fields(record: object, *names: str) -> dict[str, object]:
    """Return the named fields of an object as JSON values."""
    return {name: plain(getattr(record, name)) for name in names}


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write an indented JSON file; raise ``ValueError`` for numbers that are not finite."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")
