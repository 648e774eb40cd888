"""Output folder of a run, written as a whole, and the record of the run."""

import json
import platform
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from aerial_gym.config.storage import storage_errors
from aerial_gym.errors import DataError
from aerial_gym.registry.plugins import plugin_versions

RECORD = "run.json"  # File name of the record, which also marks a folder as the output of a run


def check_out_dir(out_dir: Path) -> None:
    """Raise ``DataError`` if a folder holds files but no record of a run."""
    if out_dir.exists() and not out_dir.is_dir():
        raise DataError(f"{out_dir}: is a file; give a folder for the results")
    if out_dir.is_dir() and any(out_dir.iterdir()) and not (out_dir / RECORD).exists():
        raise DataError(f"{out_dir}: holds other files; give a new or empty folder")


@contextmanager
def atomic_run_folder(out_dir: Path) -> Iterator[Path]:
    """Yield a temporary folder whose files move to ``out_dir`` on success and vanish on failure.

    They replace the files of an earlier run according to its record; other files in ``out_dir`` stay.

    Raises:
        DataError: If the folder holds files but no record of a run.
        StorageError: If the disk is full; ``out_dir`` is then unchanged.
    """
    check_out_dir(out_dir)
    with storage_errors(out_dir):
        out_dir.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{out_dir.name}.", dir=out_dir.parent))
    try:
        with storage_errors(out_dir, only_full=True):
            yield partial
            new = sorted(path.name for path in partial.iterdir())
            _add_file_names(partial / RECORD, new)
            old = _files_in_record(out_dir / RECORD)
            out_dir.mkdir(exist_ok=True)
            for name in new:
                (partial / name).replace(out_dir / name)
            for name in old - set(new):
                (out_dir / name).unlink(missing_ok=True)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _add_file_names(record: Path, names: list[str]) -> None:
    """Add the file names of a run to its record."""
    content = json.loads(record.read_text(encoding="utf-8")) if record.exists() else {}
    record.write_text(json.dumps(content | {"files": sorted({*names, RECORD})}, indent=1) + "\n", encoding="utf-8")


def _files_in_record(record: Path) -> set[str]:
    """Return the file names in a record; empty if unreadable or invalid."""
    try:
        names = json.loads(record.read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        return set()
    texts = {name for name in names if isinstance(name, str)} if isinstance(names, list) else set()
    return {name for name in texts if name == Path(name).name and name not in ("", ".", "..")}


def write_record(folder: Path, config: dict[str, object], inputs: dict[str, str]) -> None:
    """Write configuration, package versions and the checksums of the input files, taken at reading."""
    record = {
        "config": config,
        "versions": {name: _version(name) for name in ("aerial-gym", "torch", "numpy", "scipy", "pandas")}
        | plugin_versions,
        "python": platform.python_version(),
        "inputs": inputs,
    }
    (folder / RECORD).write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
