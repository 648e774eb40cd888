"""Compact forms of results for reference files, and the differences between two of them."""

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DIGITS = 6
"""Significant digits of a stored number."""

RELATIVE = 2e-5
"""Largest relative difference of two numbers on the same kind of machine: rounding to ``DIGITS`` is 5e-6 of it."""

ABSOLUTE = 1e-7
"""Differences below this count nowhere: correlations and offsets that are zero but for rounding."""

MACHINE_BOUND = {"hash", "late"}
"""Keys of results that another processor or library version may change by rounding: there they are notes only."""

PROSE_WORDS = 4
"""A text of at least so many words is a sentence; shorter ones are names, codes and units."""


def compact(value: Any, *, prose: bool) -> Any:
    """Return a result for a reference file: with rounded numbers, and without sentences unless ``prose`` is kept."""
    if isinstance(value, dict):
        return {str(k): compact(part, prose=prose) for k, part in value.items() if prose or not is_prose(part)}
    if isinstance(value, list | tuple):
        return [compact(part, prose=prose) for part in value if prose or not is_prose(part)]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) and math.isfinite(value) else value


def is_prose(value: Any) -> bool:
    """Return whether a value is a sentence, or a non-empty collection that holds nothing else."""
    if isinstance(value, dict | list | tuple):
        parts = list(value.values()) if isinstance(value, dict) else value
        return bool(parts) and all(is_prose(part) for part in parts)
    return isinstance(value, str) and len(re.split(r"\s+", value.strip())) >= PROSE_WORDS


def differences(reference: Any, present: Any, name: str, *, relative: float = RELATIVE) -> Iterator[str]:
    """Yield one line for each entry that differs; its path stands first."""
    if isinstance(present, dict) and "error" in present:
        yield f"{name}: {present['error']}"
    elif isinstance(reference, dict) and isinstance(present, dict):
        for key in [*reference, *(key for key in present if key not in reference)]:
            path = f"{name}/{key}"
            if key not in present:
                yield f"{path}: missing, was {_short(reference[key])}"
            elif key not in reference:
                yield f"{path}: new, {_short(present[key])}"
            else:
                yield from differences(reference[key], present[key], path, relative=relative)
    elif isinstance(reference, list) and isinstance(present, list) and len(reference) == len(present):
        for index, (old, new) in enumerate(zip(reference, present, strict=True)):
            yield from differences(old, new, f"{name}[{index}]", relative=relative)
    elif not _equal(reference, present, relative):
        yield f"{name}: {_short(reference)} -> {_short(present)}"


def _equal(reference: Any, present: Any, relative: float) -> bool:
    numbers = all(isinstance(v, int | float) and not isinstance(v, bool) for v in (reference, present))
    if numbers and float in (type(reference), type(present)):
        both = math.isnan(reference) and math.isnan(present)
        return both or math.isclose(reference, present, rel_tol=relative, abs_tol=ABSOLUTE)
    return type(reference) is type(present) and reference == present


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 200 else f"{text[:200]} ..."


def is_machine_bound(line: str) -> bool:
    """Return whether a line of ``differences`` is about a value that depends on the kind of machine."""
    return any(part in MACHINE_BOUND for part in line.partition(": ")[0].split("/"))


def read(path: Path) -> dict[str, Any]:
    """Return a reference file; an empty one if it is missing."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"machine": "", "items": {}}


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a reference file: one line for each part of an item, so that version control shows what changed."""
    items = ",\n".join(_item(name, parts) for name, parts in sorted(content["items"].items()))
    path.write_text(f'{{"machine": {json.dumps(content["machine"])},\n"items": {{\n{items}\n}}}}\n', encoding="utf-8")


def _item(name: str, parts: dict[str, Any]) -> str:
    texts = (
        (json.dumps(key), json.dumps(part, ensure_ascii=False, separators=(",", ":"))) for key, part in parts.items()
    )
    rows = ",\n".join(f"  {key}: {text}" for key, text in texts)
    return f"{json.dumps(name)}: {{\n{rows}\n}}"
