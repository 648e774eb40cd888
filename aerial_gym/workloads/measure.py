"""Timing between two synchronisations, the checks that a workload did its work, and provenance of figures and their printing.

A repeat consists of stretches: each starts from the same state, restored outside the timed span, and ends before vehicles
can leave the checked space.
"""

import os
import platform
import statistics
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Protocol, TypeVar

import torch
from rich.console import Console
from rich.table import Table

from aerial_gym.config.console import json_line
from aerial_gym.errors import AerialGymError, ConfigError
from aerial_gym.interop import record_graph
from aerial_gym.physics import BACKENDS
from aerial_gym.registry import Registry

WARM_UP_CALLS = 3  # Calls before a capture: kernels are compiled and buffers made, which a graph cannot hold


class WorkloadError(AerialGymError):
    """A timed workload failed its check, so that no figure is reported."""


class Workload(Protocol):
    """Something that can be timed; its unit is a batch of launches, one call of ``run_batch``."""

    device: torch.device
    launches_per_batch: int
    batches_per_stretch: int  # Batches after which the start is put back

    def restore(self) -> None:
        """Restore the start state, in place."""
        ...

    def run_batch(self) -> None:
        """Launch one batch, without waiting."""
        ...

    def check(self, *, started: bool) -> None:
        """Raise ``WorkloadError`` for an implausible state; ``started``: after at least one batch."""
        ...


def time_launches(workload: Workload, *, repeats: int, repeat_time_s: float) -> list[float]:
    """Return the mean time of a launch [s] in each repeat; the workload is checked before the first and after each."""
    require_at_least(1, repeats=repeats)
    if not 0.0 < repeat_time_s < float("inf"):
        raise ConfigError(f"--repeat-time-s = {repeat_time_s!r}: must be > 0 and finite")
    workload.restore()
    workload.check(started=False)
    batches = _batches_per_repeat(workload, repeat_time_s)
    seconds = []
    for _ in range(repeats):
        seconds.append(_time_batches(workload, batches) / (batches * workload.launches_per_batch))
        workload.check(started=True)
    return seconds


def _batches_per_repeat(workload: Workload, repeat_time_s: float) -> int:
    """Return the number of batches that take about ``repeat_time_s`` [s]; warms up on the way."""
    batches, elapsed = 1, _time_batches(workload, 1)  # the first one may compile: not a measurement
    while (elapsed := _time_batches(workload, batches)) < 0.2 * repeat_time_s:
        batches *= 4
    return max(1, round(batches * repeat_time_s / elapsed))


def _time_batches(workload: Workload, batches: int) -> float:
    """Return the time of ``batches`` [s]; putting the start back is not counted."""
    elapsed = 0.0
    while batches > 0:
        count = min(batches, workload.batches_per_stretch)
        workload.restore()
        wait_for_device(workload.device)
        begin = time.perf_counter()
        for _ in range(count):
            workload.run_batch()
        wait_for_device(workload.device)
        elapsed += time.perf_counter() - begin
        batches -= count
    return elapsed


def wait_for_device(device: torch.device) -> None:
    """Wait for a GPU; a CPU is never behind."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


def make_batch(call: Callable[[], None], launches: int, device: torch.device) -> Callable[[], None]:
    """Return a function that makes ``launches`` calls: a loop on the CPU, the replay of a CUDA graph on a GPU.

    ``call`` is run some times before; it must work in place and wait for nothing.
    """
    if device.type != "cuda":
        return lambda: _repeat(call, launches)
    with torch.cuda.device(device):
        side = torch.cuda.Stream(device)
        side.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(side):
            _repeat(call, WARM_UP_CALLS)
        torch.cuda.current_stream(device).wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        with record_graph(graph, device):
            _repeat(call, launches)

    def replay(_kept: Callable[[], None] = call) -> None:  # a graph does not keep the memory of its launches alive
        graph.replay()

    return replay


def _repeat(call: Callable[[], None], times: int) -> None:
    for _ in range(times):
        call()


def rate_figures(name: str, seconds: list[float], units: float) -> dict[str, float]:
    """Return median, lowest and highest rate [1/s] of launches that take ``seconds`` and hold ``units`` each, by name."""
    rates = units / statistics.median(seconds), units / max(seconds), units / min(seconds)
    return dict(zip((name, f"{name}_min", f"{name}_max"), rates, strict=True))


def require_at_least(low: int, **numbers: int) -> None:
    """Raise ``ConfigError`` naming the flag whose number is below ``low``."""
    for name, value in numbers.items():
        if value < low:
            raise ConfigError(f"--{name.replace('_', '-')} = {value!r}: must be at least {low}")


@contextmanager
def torch_threads(threads: int | None) -> Iterator[int]:
    """Run torch and the Warp backend on a number of CPU threads within the block, None for torch's own; yield the number."""
    before = torch.get_num_threads()
    if threads is not None:
        require_at_least(1, threads=threads)
        torch.set_num_threads(threads)
    try:
        yield torch.get_num_threads()
    finally:
        torch.set_num_threads(before)


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


TIMEOUT_S = 900.0  # Longest time of one measurement, compilation included [s]

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class RunFailedError(Exception):
    """A process ended without a figure; the text is its last words."""


def run_process(
    python: str, arguments: Sequence[str], *, threads: int | None = None, folder: str | Path | None = None,
    variables: Mapping[str, str] | None = None,
) -> str:  # fmt: skip
    """Return the last line that a process writes to stdout.

    With ``threads`` it is pinned to as many cores, also its libraries. It runs in the temporary folder unless another is
    given, as some peers leave logs where they run.
    """
    cores = sorted(os.sched_getaffinity(0))[:threads]
    limits = {} if threads is None else dict.fromkeys(THREAD_VARIABLES, str(threads))
    try:
        done = subprocess.run(
            [python, *arguments], cwd=folder or tempfile.gettempdir(),
            env={**os.environ, **(variables or {}), **limits}, capture_output=True, encoding="utf-8",
            errors="replace", timeout=TIMEOUT_S, preexec_fn=lambda: os.sched_setaffinity(0, cores),
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise RunFailedError(str(error)) from None
    if done.returncode != 0:
        raise RunFailedError(_last_line(done.stderr) or f"exit status {done.returncode}")
    return _last_line(done.stdout)


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    return lines[-1].strip() if lines else ""


@dataclass(frozen=True, kw_only=True)
class PeerProgram:
    """Another program under the same workload."""

    needs: tuple[str, ...]  # Modules that must be importable
    install: str  # Distributions for pip
    devices: tuple[str, ...]  # `cpu`, `cuda`


Program = TypeVar("Program", bound=PeerProgram)


def interpreters(entries: Sequence[str], peers: Registry[Program], *, default: str, flag: str) -> dict[str, str]:
    """Return the interpreter of every peer; ``entries`` are ``NAME=PYTHON``, or ``PYTHON`` for all that are not named."""
    named: dict[str, str] = {}
    for entry in entries:
        name, equals, python = entry.rpartition("=")
        if not python:
            raise ConfigError(f"{flag} {entry!r}: must be PYTHON or NAME=PYTHON, an interpreter that has the peer")
        path = os.path.abspath(python) if os.sep in python else python
        if equals:
            peers.get(name)
            named[name] = path
        else:
            default = path
    return {name: named.get(name, default) for name in peers}


def absence_reason(name: str, peer: PeerProgram, python: str, device: str, *, flag: str) -> str | None:
    """Return the reason against measuring a peer, with the remedy; None if it can be measured."""
    if device not in peer.devices:
        return f"{name} is skipped: it runs on {', '.join(peer.devices)} only."
    code = f"import importlib.util as u, sys; sys.exit(not all(map(u.find_spec, {peer.needs!r})))"
    try:
        available = subprocess.run([python, "-c", code], capture_output=True).returncode == 0
    except OSError as error:
        return f"{name} is skipped: {python} does not start ({error})."
    if available:
        return None
    return (
        f"{name} is skipped: {python} does not have it. Install it there, or in an environment of its own: python -m venv "
        f"VENV && VENV/bin/pip install {peer.install}, then {flag} {name}=VENV/bin/python"
    )
