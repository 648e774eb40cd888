"""Kernels are compiled beside other work, once each, and launches wait for them."""

import os
import threading
import time
from concurrent.futures import Future
from functools import partial
from math import inf

import pytest
import torch
import warp as wp

from aerial_gym.interop import ReusableLaunch, compile_ahead, launches, start_warp
from aerial_gym.interop.rows import RowFunction
from tests.builders import simulation
from tests.conftest import COMPILING_THREADS
from tests.refusals import assert_refused


@wp.kernel(module="unique", enable_backward=False)
def _fill(value: float, out: wp.array[float]):
    out[wp.tid()] = value


@wp.kernel(module="unique", enable_backward=False)
def _wrong(out: wp.array[float]):
    out[wp.tid()] = wp.length(2.0)


@pytest.fixture
def cpu(monkeypatch: pytest.MonkeyPatch) -> wp.Device:
    """Warp's CPU, with threads that compile and nothing that was compiled ahead."""
    start_warp()
    monkeypatch.setattr(launches, "_begun", {})
    monkeypatch.setattr(launches, "_workers", COMPILING_THREADS)
    return wp.get_device("cpu")


@pytest.fixture
def idle(cpu: wp.Device, monkeypatch: pytest.MonkeyPatch) -> wp.Device:
    """The same with threads that never compile: for tests of what is begun, and how."""
    monkeypatch.setattr(launches, "_workers", Idle)
    return cpu


class Idle:
    def submit(self, *_: object, **__: object) -> Future[None]:
        done: Future[None] = Future()
        done.set_result(None)
        return done


def test_a_launch_waits_for_its_kernel_and_its_making_does_not(cpu: wp.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    go, force_load = threading.Event(), wp.force_load
    loaded: list[object] = []

    def late(**given: object) -> None:
        go.wait(60.0)
        loaded.append(given["modules"])
        force_load(**given)

    monkeypatch.setattr(wp, "force_load", late)
    out = torch.full((3,), float("nan"))
    make = partial(ReusableLaunch, _fill, dim=3, outputs=[wp.from_torch(out)], device=cpu)
    made = [make(inputs=[value]) for value in (1.0, 2.0)]
    assert not loaded
    threading.Timer(0.1, go.set).start()
    for launch, value in zip(made, (1.0, 2.0), strict=True):
        launch.launch()
        assert loaded == [[_fill.module]]  # once, for both
        assert out.tolist() == [value] * 3


def test_an_argument_is_replaced_and_a_wrong_kernel_is_told_at_the_launch(cpu: wp.Device) -> None:
    out = torch.zeros(2)
    launch = ReusableLaunch(_fill, dim=2, inputs=[1.0], outputs=[wp.from_torch(out)], device=cpu)
    launch.set_param_at_index(0, 5.0)
    launch.launch()
    assert out.tolist() == [5.0, 5.0]
    launch = ReusableLaunch(_wrong, dim=1, inputs=[], outputs=[wp.zeros(1, dtype=float, device=cpu)], device=cpu)
    assert_refused(Exception, "length", launch.launch)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_forked_process_compiles_with_workers_of_its_own(cpu: wp.Device) -> None:
    """Threads do not survive a fork: a child that waited for its parent's would wait for ever."""
    compile_ahead(_fill, cpu)
    launches.wait_for_kernel(_fill, cpu)
    child = os.fork()
    if child == 0:
        launches._begun.clear()
        compile_ahead(_fill, cpu)
        launches.wait_for_kernel(_fill, cpu)
        os._exit(7)
    until = time.monotonic() + 60.0
    while (ended := os.waitpid(child, os.WNOHANG))[0] == 0 and time.monotonic() < until:
        time.sleep(0.05)
    if ended[0] == 0:
        os.kill(child, 9)
        os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(ended[1]) == 7


def test_what_an_empty_environment_does_not_need_is_not_compiled(idle: wp.Device) -> None:
    env = simulation("base_quadrotor", "lee_velocity_control")
    env.reset()
    env.step(torch.zeros(2, 4))
    assert env.gtd["robot_clearance"].tolist() == [inf, inf]
    names = [module.name for module, *_ in launches._begun]
    assert any("advance" in name for name in names)
    assert not [name for name in names if "walk" in name or "placement" in name]


def test_everything_is_compiled_with_the_same_flags(idle: wp.Device) -> None:
    """Warp precompiles its headers for every set of flags anew, which takes longer than most kernels."""
    simulation("base_quadrotor_with_camera", "lee_velocity_control", env="env_with_obstacles")
    modules = [module for module, *_ in launches._begun]
    assert len(modules) >= 8
    assert len({module.options["cpu_compiler_flags"] for module in modules}) == 1


def test_a_kernel_of_very_many_lines_is_not_searched_for_vectors(idle, monkeypatch) -> None:
    """It takes 8 lines for each column: of 400, 25 columns are few and 75 many."""
    monkeypatch.setattr(launches, "LONGEST_SEARCHED", 400)

    def spread(given: torch.Tensor) -> torch.Tensor:
        for _ in range(4):
            given = given.sin() * given
        return given

    for columns, searched in ((25, True), (75, False)):
        rows = RowFunction(spread, [torch.ones(2, columns)])
        flags = rows.kernel.module.options["cpu_compiler_flags"]
        assert ("-fno-slp-vectorize" not in flags) == searched
        assert launches.HEADER_FLAGS in flags


def test_on_a_gpu_each_size_of_block_is_compiled_once(idle: wp.Device) -> None:
    """A GPU has a module for each number of threads of a block; a CPU has one."""

    class Gpu:
        is_cpu, alias = False, "cuda:0"

    for block_dim in (64, 256, 64):
        compile_ahead(_fill, Gpu(), block_dim=block_dim)
        compile_ahead(_fill, idle, block_dim=block_dim)
    assert [key[1:] for key in launches._begun] == [("cuda:0", 64), ("cpu", None), ("cuda:0", 256)]


def test_a_recording_waits_for_all_kernels(cpu: wp.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """A GPU loads no module while a CUDA graph is recorded."""
    go, loaded = threading.Event(), threading.Event()

    def late(**_: object) -> None:
        go.wait(60.0)
        loaded.set()

    monkeypatch.setattr(wp, "force_load", late)
    compile_ahead(_fill, cpu)
    threading.Timer(0.05, go.set).start()
    launches.wait_for_all()
    assert loaded.is_set()
