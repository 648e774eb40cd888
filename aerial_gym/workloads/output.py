"""Provenance of figures, and their printing."""

import os
import platform
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import torch
from rich.console import Console
from rich.table import Table

from aerial_gym.config.console import json_line
from aerial_gym.physics import BACKENDS

PACKAGES = ("torch", "warp-lang", "aerial-gym")


def device_name(device: torch.device) -> str:
    """Return the processor name of a device."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    models = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(models, platform.processor() or platform.machine())


def provenance(*packages: str) -> dict[str, object]:
    """Return versions, also of further packages, commit, and load of the machine [processes, mean of a minute]."""
    versions = {name.removesuffix("-lang").replace("-", "_"): _package_version(name) for name in (*PACKAGES, *packages)}
    return {
        "versions": {**versions, "python": platform.python_version()},
        "commit": commit_hash(),
        "load1": round(os.getloadavg()[0], 2),
    }


def packages_of_backend(backend: str | None) -> tuple[str, ...]:
    """Return the additional packages that a registered backend needs."""
    return () if backend in (None, "auto") else getattr(BACKENDS.get(backend), "packages", ())


def commit_hash() -> str | None:
    """Return the short hash of the checkout, with ``-dirty`` if it was changed; None outside a checkout."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    try:
        process = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, encoding="utf-8", errors="replace", check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return process.stdout.strip()


def print_figures(figures: Mapping[str, object], *, as_json: bool) -> None:
    """Print one object a line for programs, or a table for people."""
    if as_json:
        print(json_line(figures))
        return
    table = Table(box=None, pad_edge=False, show_header=False)
    for name, value in figures.items():
        table.add_row(name, format_value(value))
    Console(markup=False, highlight=False).print(table)


def format_value(value: object) -> str:
    """Return a value as a person wants it: ``12.7 M`` for 12.7e6, no brackets around lists."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {entry}" for key, entry in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(str, value)) or "none"
    if not isinstance(value, float):
        return "-" if value is None else str(value)
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if abs(value) >= size:
            return f"{value / size:.4g}{unit}"
    return f"{value:.4g}"


def _package_version(package: str) -> str:
    """Return the installed version of a package, or a note on a source tree without metadata."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "not installed, used from source"
