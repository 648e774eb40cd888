"""What a run needs around its calculation: a folder that appears whole, a record of what was run."""

import hashlib
import json
import platform
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from aerial_gym.errors import DataError

RECORD = "run.json"
"""Name of the record; it also marks a folder as one of ours."""


def check_out_dir(out_dir: Path) -> None:
    """Raise ``DataError`` if a folder holds something that a run did not write: it would be replaced."""
    if out_dir.exists() and not out_dir.is_dir():
        raise DataError(f"{out_dir}: is a file; give a folder for the results")
    if out_dir.is_dir() and any(out_dir.iterdir()) and not (out_dir / RECORD).exists():
        raise DataError(f"{out_dir}: holds other files and would be replaced; give a new or empty folder")


@contextmanager
def whole_folder(out_dir: Path) -> Iterator[Path]:
    """Give a folder to write into; it takes the place of ``out_dir`` at the end, or vanishes if anything fails."""
    check_out_dir(out_dir)
    out_dir.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(prefix=f".{out_dir.name}.", dir=out_dir.parent))
    try:
        yield partial
        partial.chmod(0o755)
        if out_dir.exists():
            shutil.rmtree(out_dir)
        partial.rename(out_dir)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def write_record(folder: Path, config: dict[str, object], inputs: Sequence[str | Path]) -> None:
    """Write what was run, with which versions, on which files."""
    record = {
        "config": config,
        "versions": {name: _version(name) for name in ("aerial-gym", "torch", "numpy", "scipy", "pandas")},
        "python": platform.python_version(),
        "inputs": {str(path): hashlib.sha256(Path(path).read_bytes()).hexdigest() for path in inputs},
    }
    (folder / RECORD).write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
