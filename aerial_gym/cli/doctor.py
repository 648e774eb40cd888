"""``aerial-gym doctor``: versions, devices, caches and missing packages, with the command that repairs each."""

import os
import platform
import shutil
from dataclasses import dataclass
from importlib import metadata
from typing import TYPE_CHECKING, Any

from aerial_gym import __version__
from aerial_gym.cli.cache import cache_rows, find_caches
from aerial_gym.cli.terminal import print_table
from aerial_gym.config.console import json_line
from aerial_gym.errors import StorageError
from aerial_gym.extras import PROJECT, extra_packages, requirements

if TYPE_CHECKING:
    from packaging.requirements import Requirement


@dataclass(frozen=True, kw_only=True)
class DoctorCmd:
    """Report versions, devices, caches and missing packages, each fault with the command that repairs it."""

    json: bool = False  # Print one JSON object instead of tables

    def run(self) -> int:
        """Print the report; return 0, or 1 if something is broken. A missing extra is not a fault."""
        report = examine()
        if self.json:
            print(json_line(report, indent=2))
        else:
            _print_report(report)
        return 1 if report["faults"] else 0


def examine() -> dict[str, Any]:
    """Return versions, devices, caches, extras with their missing packages, and faults with their repair."""
    faults = [
        {
            "fault": f"{row} is needed, and {_version(row.name) or 'none'} is installed",
            "repair": f"pip install '{_rule(row)}'",
        }
        for row in _unmet(requirements().get("", ()))
    ]
    if not requirements():
        faults.append({"fault": f"{PROJECT} runs from a folder that pip does not know", "repair": "pip install -e ."})
    devices = _devices(faults)
    caches: dict[str, Any] = {}
    try:
        caches = {name: cache.entry() for name, cache in find_caches().items()}
    except StorageError as error:
        faults.append({"fault": str(error), "repair": "export WARP_CACHE_PATH=FOLDER, one that can be written"})
    core = [row.name for row in requirements().get("", ())]
    return {
        "versions": {PROJECT: __version__, "python": platform.python_version(), "platform": platform.platform()}
        | {name: _version(name) for name in core},
        "devices": devices,
        "caches": caches,
        "extras": {name: _extra(name) for name in requirements() if name and extra_packages(name)},
        "programs": {
            "C compiler": {"needed_for": "checks of exported C, sitl", **_program("gcc", "cc")},
            "make": {"needed_for": "sitl", **_program("make")},
        },
        "faults": faults,
    }


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _rule(row: "Requirement") -> str:
    return f"{row.name}{row.specifier}"


def _unmet(rows: "tuple[Requirement, ...]") -> "list[Requirement]":
    """Return the requirements whose package is missing or of another version."""
    versions = {row: _version(row.name) for row in rows}
    return [row for row, version in versions.items() if version is None or not row.specifier.contains(version, True)]


def _extra(name: str) -> dict[str, Any]:
    missing = [_rule(row) for row in _unmet(extra_packages(name))]
    return {"missing": missing, "repair": f"pip install '{PROJECT}[{name}]'" if missing else None}


def _program(*names: str) -> dict[str, str | None]:
    path = next(filter(None, map(shutil.which, names)), None)
    return {"path": path, "repair": None if path else f"install {names[0]} with the package manager of your system"}


def _devices(faults: list[dict[str, str]]) -> list[dict[str, Any]]:
    """Return the CPU and the GPUs that torch can use; add a fault for a GPU that it cannot."""
    devices: list[dict[str, Any]] = [{"device": "cpu", "name": platform.machine(), "cores": os.cpu_count()}]
    try:
        import torch

        from aerial_gym.interop.warp_start import has_gpu_driver
    except ImportError as error:
        faults.append({"fault": f"torch cannot be imported: {error}", "repair": "pip install --force-reinstall torch"})
        return devices
    for number in range(torch.cuda.device_count()):
        known = torch.cuda.get_device_properties(number)
        memory = round(known.total_memory / 2**30, 1)
        devices.append({"device": f"cuda:{number}", "name": known.name, "memory_gib": memory})
    if has_gpu_driver() and not torch.cuda.is_available():
        build = f"built for CUDA {torch.version.cuda}" if torch.version.cuda else "a build for CPUs only"
        faults.append({
            "fault": f"a GPU driver is installed, but torch {torch.__version__} ({build}) finds no GPU",
            "repair": "run nvidia-smi; then install the build of torch for its CUDA version (pytorch.org, Get Started)",
        })  # fmt: skip
    return devices


def _print_report(report: dict[str, Any]) -> None:
    print_table(((name, version or "missing") for name, version in report["versions"].items()), title="versions")
    rows = ((entry["device"], entry["name"], _size(entry)) for entry in report["devices"])
    print_table(rows, title="\ndevices")
    print_table(cache_rows(report["caches"]), title="\ncaches")
    rows = (
        (name, ", ".join(entry["missing"]) or "installed", entry["repair"] or "")
        for name, entry in report["extras"].items()
    )
    print_table(rows, ("extra", "missing", "to install"), title="\noptional packages")
    rows = ((name, entry["path"] or "missing", entry["repair"] or "") for name, entry in report["programs"].items())
    print_table(rows, title="\nprograms")
    faults = ((entry["fault"], entry["repair"]) for entry in report["faults"])
    if report["faults"]:
        print_table(faults, ("fault", "repair"), title="\nfaults")
    else:
        print("\nno faults")


def _size(entry: dict[str, Any]) -> str:
    return f"{entry['cores']} cores" if "cores" in entry else f"{entry['memory_gib']} GiB"
