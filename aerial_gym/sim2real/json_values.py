"""Conversion of results to JSON."""

import json
from collections.abc import Callable, Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np


def map_leaves(content: Any, convert: Callable[[Any], Any]) -> Any:
    """Return nested mappings and lists with every other value converted."""
    if isinstance(content, Mapping):
        return {name: map_leaves(part, convert) for name, part in content.items()}
    return [map_leaves(part, convert) for part in content] if isinstance(content, list | tuple) else convert(content)


def finite_or_none(value: Any) -> Any:
    """Return a value, or None for a number that is infinite or NaN."""
    return None if isinstance(value, float) and not isfinite(value) else value


def plain(content: object) -> object:
    """Return a JSON value, recursively: ``as_mapping`` of objects, lists for arrays and tuples."""

    def plain_leaf(value: Any) -> object:
        if hasattr(value, "as_mapping"):
            return value.as_mapping()
        return value.tolist() if isinstance(value, np.ndarray) else value

    return map_leaves(content, plain_leaf)


def select_fields(record: object, *names: str) -> dict[str, object]:
    """Return the named fields of an object as JSON values."""
    return {name: plain(getattr(record, name)) for name in names}


def write_json(path: Path, content: Mapping[str, object]) -> None:
    """Write an indented JSON file; raise ``ValueError`` for numbers that are not finite."""
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8", errors="surrogateescape")
