"""Settings of all tests: threads of a worker, optimisation of kernels, lifetime of registered names. Warp kernels for
CPUs are compiled at their first launch. Most tests run unoptimised kernels, which compile in half of the time. Tests
with the fixture ``optimised``, and a run of slow tests only, run the kernels of users: the optimiser contracts products
into sums, so that rounding differs."""

import gc
import os
import sys
import tomllib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import cache
from importlib import invalidate_caches
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

gc.disable()  # Until all tests are collected: their modules stay

_CORES = len(os.sched_getaffinity(0))
_WANTED = int(os.environ.get("OMP_NUM_THREADS", "2"))
_THREADS = max(1, min(2, _WANTED, _CORES // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))

os.environ["AERIAL_GYM_NO_PLUGINS"] = "1"  # No test depends on installed plug-ins; the fixture `install` turns them on

# Workers with more threads than cores wait for each other. Processes that tests start inherit the number.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(_THREADS)))

import pytest  # noqa: E402
import torch  # noqa: E402
import warp as wp  # noqa: E402

from aerial_gym.assets import ENVIRONMENTS, FAMILIES  # noqa: E402
from aerial_gym.control import CONTROL_LAWS, CONTROLLERS  # noqa: E402
from aerial_gym.env_manager import SIMS  # noqa: E402
from aerial_gym.interop import launches  # noqa: E402
from aerial_gym.physics import BACKENDS, EFFECTS, ROTOR_MAPS, warp_backend  # noqa: E402
from aerial_gym.physics.fused.kernel import make_kernel  # noqa: E402
from aerial_gym.registry import plugins  # noqa: E402
from aerial_gym.registry.log_formats import LOG_READERS  # noqa: E402
from aerial_gym.rl_training import TRAINERS  # noqa: E402
from aerial_gym.robots import ROBOTS  # noqa: E402
from aerial_gym.sensors import IMUS, SENSORS, imu  # noqa: E402
from aerial_gym.sim2real.predict import replay  # noqa: E402
from aerial_gym.task import ACTIONS, BUFFERS, COMMANDS, OBSERVATIONS, REWARDS, TERMINATIONS, task_registry  # noqa: E402
from tests.ci_libraries import pytest_sessionfinish  # noqa: E402, F401

torch.set_num_threads(_THREADS)

level: int | None = 0
"""Optimisation level of kernels for a CPU; None is the level of users."""

level_of_rays: int | None = None
"""Optimisation level of ray kernels; most tests that cast rays cast many."""

level_of_adjoints: int | None = 0
"""Optimisation level of differentiable fused kernels: level 0 compiles in 7 s, the level of users in 22 s."""

_compiler_flags_of_long_kernel: WeakKeyDictionary[wp.Module, str | None] = WeakKeyDictionary()
"""The flags of each module as users have them."""


def has_adjoint(module: wp.Module) -> bool:
    """Return whether a kernel of the module is differentiable; its loops must be unrolled to keep all values."""
    whole = module.options["enable_backward"]
    return any(kernel.options.get("enable_backward", whole) for kernel in module.kernels.values())


LONG_RUNS = (replay.__name__, imu.__name__)
"""Modules whose kernels run longer than they compile: replays of flights and records of IMUs."""


def is_long_run(module: wp.Module) -> bool:
    """Return whether a kernel of the module belongs to ``LONG_RUNS``."""
    return any((kernel.func.__module__ or "").startswith(LONG_RUNS) for kernel in module.kernels.values())


def set_level(module: wp.Module) -> None:
    """Set the optimisation of a module: none for modules that compile for minutes, full for long runs, else ``level``.
    Ray kernels are optimised without Warp's eager inlining: they run 10 % faster, but would compile three times longer
    for each combination of images. Unoptimised kernels keep their loops and suit any CPU; this saves a third of the
    compilation."""
    flags = _compiler_flags_of_long_kernel.setdefault(module, module.options["cpu_compiler_flags"])
    rays, long = "cast_by_tile" in module.name, is_long_run(module)
    chosen = level_of_rays if rays else 0 if "-fno-slp-vectorize" in (flags or "") else None if long else level
    if chosen == 0:
        flags = launches.HEADER_FLAGS
    elif rays or long:
        flags = f"-march=native {launches.HEADER_FLAGS}"
    unroll = wp.config.max_unroll if chosen != 0 or has_adjoint(module) else 1
    module.options |= {"optimization_level": chosen, "cpu_compiler_flags": flags, "max_unroll": unroll}


def set_levels() -> None:
    """Set the optimisation of the modules of all launched kernels; they are compiled again at their next launch."""
    for module, *_ in launches._begun:
        set_level(module)
        module.mark_modified()


class CompileAtLaunch:
    """Replacement for the threads of ``compile_ahead`` that compiles nothing, so that only launched kernels are
    compiled. ``unit/interop/test_launches.py`` tests the threads themselves; processes that tests start have them."""

    def submit(self, load: object, *, modules: list[wp.Module], **kwargs: object) -> Future[None]:
        for module in modules:
            set_level(module)
        done: Future[None] = Future()
        done.set_result(None)
        return done


def load_quickly(module: wp.Module, device: wp.DeviceLike, *args: Any, **kwargs: Any) -> Any:
    """Load a module; set the optimisation and the headers of one that ``compile_ahead`` has not seen."""
    if module.options["cpu_compiler_flags"] is None and wp.get_device(device).is_cpu:
        module.options["cpu_compiler_flags"] = f"{wp.config.cpu_compiler_flags} {launches.HEADER_FLAGS}"
        set_level(module)
    return load(module, device, *args, **kwargs)


def make_kernel_quickly(*args: Any, differentiable: bool, **kwargs: Any) -> wp.Kernel:
    """Make a fused kernel; a differentiable one, which is not compiled ahead, gets ``level_of_adjoints``."""
    kernel = make_kernel(*args, differentiable=differentiable, **kwargs)
    if differentiable and level_of_adjoints is not None:
        kernel.module.options["optimization_level"] = level_of_adjoints
    return kernel


load = wp.Module.load
wp.Module.load = load_quickly
warp_backend.make_kernel = make_kernel_quickly
COMPILING_THREADS = launches._workers
launches._workers = cache(CompileAtLaunch)

REGISTRIES = (
    SIMS, ENVIRONMENTS, ROBOTS, CONTROLLERS, SENSORS, IMUS, task_registry,
    ACTIONS, BUFFERS, COMMANDS, OBSERVATIONS, REWARDS, TERMINATIONS,
    BACKENDS, CONTROL_LAWS, EFFECTS, FAMILIES, LOG_READERS, ROTOR_MAPS, TRAINERS,
)  # fmt: skip


def pytest_collection_finish(session: pytest.Session) -> None:
    """Optimise kernels in a run of slow tests only; collect garbage seldom, as it takes a tenth of the time by default."""
    global level, level_of_adjoints
    if session.items and all(item.get_closest_marker("slow") for item in session.items):
        level = level_of_adjoints = None
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 20)
    gc.enable()


@pytest.fixture(autouse=True, scope="module")
def own_names() -> Iterator[None]:
    """Remove the names that a module's tests and fixtures have registered, and their task files."""
    before = [set(registry.names()) for registry in REGISTRIES]
    yield
    for registry, names in zip(REGISTRIES, before, strict=True):
        for name in set(registry.names()) - names:
            del registry._entries[name]
            registry._plugins.pop(name, None)
    for name in [name for name in sys.modules if name.startswith("aerial_gym_task_")]:
        del sys.modules[name]


@pytest.fixture
def own_registries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Restore all registries after a test."""
    for registry in REGISTRIES:
        for name in ("_entries", "_plugins"):
            monkeypatch.setattr(registry, name, dict(getattr(registry, name)))


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, own_registries: None) -> Iterator[Callable[..., Path]]:
    """Return ``install(package, points, **files)``: write a package with its metadata, and forget all plug-ins known."""
    folder, packages = tmp_path / "site", set[str]()
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delenv(plugins.SWITCH)

    def add(package: str, points: dict[str, str], version: str = "1.0", **files: str) -> Path:
        """Return the folder that holds all packages; ``files``: source by module."""
        packages.update(value.partition(":")[0].partition(".")[0] for value in points.values())
        metadata = folder / f"{package.replace('-', '_')}-{version}.dist-info"
        metadata.mkdir(parents=True)
        text = f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n"
        (metadata / "METADATA").write_text(text, encoding="utf-8")
        lines = (f"{name} = {value}" for name, value in points.items())
        (metadata / "entry_points.txt").write_text("\n".join((f"[{plugins.GROUP}]", *lines, "")), encoding="utf-8")
        for name, content in files.items():
            (folder / f"{name}.py").write_text(content, encoding="utf-8")
        invalidate_caches()
        plugins.find_plugins.cache_clear()
        for registry in REGISTRIES:
            monkeypatch.setattr(registry, "_has_plugins", not registry._plugin_kinds)
        return folder

    yield add
    plugins.find_plugins.cache_clear()
    for name in [name for name in sys.modules if name.partition(".")[0] in packages]:
        del sys.modules[name]


@pytest.fixture
def install_project(install: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Return a replacement for ``pip install FOLDER``: it reads ``pyproject.toml`` and leaves the modules in their folder."""

    def add(home: Path) -> None:
        project = tomllib.loads((home / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        monkeypatch.syspath_prepend(str(home.resolve()))
        install(project["name"], project["entry-points"][plugins.GROUP], project["version"])

    return add


@pytest.fixture(autouse=True)
def own_threads() -> Iterator[None]:
    """Restore the number of threads after each test: with more threads than cores, workers wait for each other."""
    yield
    torch.set_num_threads(_THREADS)


@pytest.fixture(params=["cpu", *(["cuda:0"] if torch.cuda.is_available() else [])])
def device(request: pytest.FixtureRequest) -> torch.device:
    """Return the CPU, then the first GPU if there is one."""
    return torch.device(request.param)


@pytest.fixture
def optimise_kernels() -> Iterator[None]:
    """Compile kernels as users have them, also those that were launched before. Each family of kernels has tests with
    this fixture; the others compare unoptimised ones. Tests of batch independence need it: the optimiser decides which
    environments share a vector instruction, and which products it contracts into sums."""
    global level, level_of_rays
    before, level, level_of_rays = (level, level_of_rays), None, None
    set_levels()
    yield
    level, level_of_rays = before
    set_levels()


@pytest.fixture(scope="module")
def few_rays() -> Iterator[None]:
    """Compile ray kernels like the others in a module with small images of many combinations."""
    global level_of_rays
    level_of_rays = level
    set_levels()
    yield
    level_of_rays = None
    set_levels()


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest) -> Iterator[int]:
    """Run torch on so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.fixture
def coarser_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fly ``benchmarks.undeclared`` in steps of 1.25 ms in place of 0.5 ms, which moves no flight by 1e-7 mm. A delay
    is rounded to steps: where one is measured, the short ones are needed."""
    monkeypatch.setattr("benchmarks.undeclared.simulate.SUBSTEPS", 2)
