"""Settings of all tests: as many threads as there are cores for each worker, or ``OMP_NUM_THREADS``; kernels are compiled when
they are launched, mostly without optimisation; what a module's tests register goes with them.
"""

import gc
import os
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from functools import cache
from typing import Any
from weakref import WeakKeyDictionary

_CORES = len(os.sched_getaffinity(0))
_WANTED = int(os.environ.get("OMP_NUM_THREADS", "2"))
_THREADS = max(1, min(2, _WANTED, _CORES // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))

# Workers that have more threads than cores wait for each other; processes that tests start inherit the number.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(_THREADS)))

import pytest  # noqa: E402
import torch  # noqa: E402
import warp as wp  # noqa: E402

from aerial_gym.assets import ENVIRONMENTS  # noqa: E402
from aerial_gym.control import CONTROLLERS  # noqa: E402
from aerial_gym.env_manager import SIMS  # noqa: E402
from aerial_gym.interop import launches  # noqa: E402
from aerial_gym.physics import warp_backend  # noqa: E402
from aerial_gym.physics.fused.kernel import make_kernel  # noqa: E402
from aerial_gym.robots import ROBOTS  # noqa: E402
from aerial_gym.sensors import IMUS, SENSORS, imu  # noqa: E402
from aerial_gym.sim2real.predict import replay  # noqa: E402
from aerial_gym.task import (  # noqa: E402
    ACTIONS,
    BUFFERS,
    COMMANDS,
    OBSERVATIONS,
    REWARDS,
    TERMINATIONS,
    task_registry,
)

torch.set_num_threads(_THREADS)

level: int | None = 0
"""How far kernels for a CPU are optimised; None: as users have them."""

level_of_rays: int | None = None
"""The same of rays, which are many in most tests that cast them."""

_own_flags: WeakKeyDictionary[wp.Module, str | None] = WeakKeyDictionary()
"""The flags of each module as users have them."""


def has_adjoint(module: wp.Module) -> bool:
    """Return whether a kernel is differentiated: loops that are not unrolled would keep the last of their values alone."""
    whole = module.options["enable_backward"]
    return any(kernel.options.get("enable_backward", whole) for kernel in module.kernels.values())


RUN_LONG = (replay.__name__, imu.__name__)
"""Whose kernels run for longer than they are compiled: along flights, hundreds of times in a loop, and for records of IMUs."""


def runs_long(module: wp.Module) -> bool:
    """Return whether a kernel of a module is one of ``RUN_LONG``."""
    return any((kernel.func.__module__ or "").startswith(RUN_LONG) for kernel in module.kernels.values())


def set_level(module: wp.Module) -> None:
    """Optimise a module as far as is wanted now; never what is so long that this takes minutes, always what runs long.

    Rays are optimised without Warp's eager inlining, which makes them a tenth faster and takes three times as long, for each
    combination of images that tests ask for. What is not optimised keeps its loops and is for any CPU: compiled in two thirds
    of the time.
    """
    flags = _own_flags.setdefault(module, module.options["cpu_compiler_flags"])
    rays, long = "cast_by_tile" in module.name, runs_long(module)
    wanted = level_of_rays if rays else 0 if "-fno-slp-vectorize" in (flags or "") else None if long else level
    if wanted == 0:
        flags = launches.NO_BFLOAT16
    elif rays or long:
        flags = f"-march=native {launches.NO_BFLOAT16}"
    unrolled = wp.config.max_unroll if wanted != 0 or has_adjoint(module) else 1
    module.options |= {"optimization_level": wanted, "cpu_compiler_flags": flags, "max_unroll": unrolled}


def set_levels() -> None:
    """Optimise the modules of all kernels that were begun as far as is wanted now."""
    for module, *_ in launches._begun:
        set_level(module)
        module.mark_modified()


class CompileAtLaunch:
    """Stands for the threads of ``compile_ahead`` and compiles nothing: what a test builds and never launches is not compiled.

    The threads themselves are tested in ``unit/interop/test_launches.py``, and in every process that a test starts. What it
    launches is compiled without optimisation, in less than half of the time, unless it asks for it as ``optimised``.
    """

    def submit(self, load: object, *, modules: list[wp.Module], **kwargs: object) -> Future[None]:
        for module in modules:
            set_level(module)
        done: Future[None] = Future()
        done.set_result(None)
        return done


def load_quickly(module: wp.Module, device: wp.DeviceLike, *args: Any, **kwargs: Any) -> Any:
    """Load a module; one that was not begun before is optimised as far as is wanted now, and has the headers of the others."""
    if module.options["cpu_compiler_flags"] is None and wp.get_device(device).is_cpu:
        module.options["cpu_compiler_flags"] = f"{wp.config.cpu_compiler_flags} {launches.NO_BFLOAT16}"
        set_level(module)
    return load(module, device, *args, **kwargs)


def make_kernel_quickly(*args: Any, differentiable: bool, **kwargs: Any) -> wp.Kernel:
    """Make a fused kernel; an adjoint, which is not compiled ahead, without optimisation: 7 s of compilation in place of 22."""
    kernel = make_kernel(*args, differentiable=differentiable, **kwargs)
    if differentiable:
        kernel.module.options["optimization_level"] = 0
    return kernel


load = wp.Module.load
wp.Module.load = load_quickly
warp_backend.make_kernel = make_kernel_quickly
COMPILING_THREADS = launches._workers
launches._workers = cache(CompileAtLaunch)

REGISTRIES = (
    SIMS, ENVIRONMENTS, ROBOTS, CONTROLLERS, SENSORS, IMUS, task_registry,
    ACTIONS, BUFFERS, COMMANDS, OBSERVATIONS, REWARDS, TERMINATIONS,
)  # fmt: skip


def pytest_collection_finish() -> None:
    """Spare the collector what was imported, and let it go through the rest seldom: by default it takes a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 20)


@pytest.fixture(autouse=True, scope="module")
def own_names() -> Iterator[None]:
    """Drop the names that the tests of a module, or their fixtures, have registered, and the task files that did."""
    before = [set(registry.names()) for registry in REGISTRIES]
    yield
    for registry, names in zip(REGISTRIES, before, strict=True):
        for name in set(registry.names()) - names:
            del registry._entries[name]
    for name in [name for name in sys.modules if name.startswith("aerial_gym_task_")]:
        del sys.modules[name]


@pytest.fixture(autouse=True)
def own_threads() -> Iterator[None]:
    """Give the next test as many threads as this one had: with more than cores, workers wait for each other."""
    yield
    torch.set_num_threads(_THREADS)


@pytest.fixture
def optimised() -> Iterator[None]:
    """Compile kernels as users have them, those that were launched before included.

    Each family of kernels has tests with this; its other members are compared without, in less than half of the time. So has
    what must not depend on the batch: the optimiser decides what is done side by side, and which products are fused into sums.
    """

    global level, level_of_rays
    before, level, level_of_rays = (level, level_of_rays), None, None
    set_levels()
    yield
    level, level_of_rays = before
    set_levels()


@pytest.fixture(scope="module")
def few_rays() -> Iterator[None]:
    """Compile kernels of rays without optimisation in a module whose images are small, and of many combinations."""
    global level_of_rays
    level_of_rays = 0
    set_levels()
    yield
    level_of_rays = None
    set_levels()


@pytest.fixture
def coarser_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fly ``benchmarks.undeclared`` in steps of 1.25 ms in place of 0.5 ms, which moves no flight by 1e-7 mm.

    A delay is rounded to steps: where one is measured, the short ones are needed.
    """
    monkeypatch.setattr("benchmarks.undeclared.simulate.SUBSTEPS", 2)
