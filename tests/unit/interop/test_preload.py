"""What happens beside imports and compilation: libraries, messages of Warp, threads, and caches that cannot be written."""

import ctypes
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import warp as wp
from scipy.linalg import solve_triangular
from threadpoolctl import threadpool_info

from aerial_gym.errors import StorageError
from aerial_gym.interop import one_thread, start_warp
from aerial_gym.interop import preload as module
from aerial_gym.interop.warp_start import KernelLog
from tests.refusals import assert_refused


class Driver:
    def __init__(self, status: int = 0) -> None:
        self.calls: list[object] = []
        self._status = status

    def cuInit(self, flags: int) -> int:  # noqa: N802
        self.calls.append(("init", flags))
        return self._status

    def cuDeviceGet(self, handle: object, index: int) -> int:  # noqa: N802
        self.calls.append(("device", index))
        return 0 if index < 2 else 101

    def cuDevicePrimaryCtxRetain(self, context: object, handle: ctypes.c_int) -> int:  # noqa: N802
        self.calls.append("context")
        return 0


def run_preload(driver: Driver, monkeypatch: pytest.MonkeyPatch, device: str | None) -> list[object]:
    monkeypatch.setattr(module, "_load_torch_and_triton", lambda gpu: None)
    monkeypatch.setattr(module, "_dlopen", lambda *_: None)
    monkeypatch.setattr(module.ctypes, "CDLL", lambda name: driver)
    for thread in module.preload(device):
        thread.join()
    return driver.calls


@pytest.mark.parametrize(("device", "index"), [(None, 0), ("auto", 0), ("cuda", 0), ("cuda:1", 1)])
def test_the_context_is_that_of_the_device(device: str | None, index: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LOCAL_RANK", raising=False)
    assert run_preload(Driver(), monkeypatch, device) == [("init", 0), ("device", index), "context"]


def test_the_context_of_a_process_is_that_of_its_own_gpu_with_a_working_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert ("device", 1) in run_preload(Driver(), monkeypatch, "cuda")
    assert run_preload(Driver(status=100), monkeypatch, "cuda") == [("init", 0)]
    assert run_preload(Driver(), monkeypatch, "cuda:7") == [("init", 0), ("device", 7)]


@pytest.mark.parametrize("device", ["cpu", "cpu:0", "cuda:x", "mps"])
def test_other_devices_have_no_context(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_preload(Driver(), monkeypatch, device) == []


def test_a_library_loads_by_a_call_that_releases_the_lock_of_python() -> None:
    """The flag of ``ctypes.PyDLL``, which keeps the lock, is absent."""
    assert module._dlopen(b"libm.so.6", os.RTLD_NOW) is not None
    assert module._dlopen(b"/missing/libnone.so", os.RTLD_NOW) is None
    assert not type(module._dlopen)._flags_ & ctypes.PyDLL._func_flags_ & ~ctypes.CDLL._func_flags_


def test_triton_hashes_its_files_for_a_gpu_only(monkeypatch: pytest.MonkeyPatch) -> None:
    hashed: list[str] = []
    monkeypatch.setattr(module, "_dlopen", lambda *_: None)
    cache = SimpleNamespace(triton_key=lambda: hashed.append("key"))
    monkeypatch.setattr(module, "import_module", lambda name: {"triton.runtime.cache": cache}[name])
    module._load_torch_and_triton(gpu=False)
    assert not hashed
    module._load_torch_and_triton(gpu=True)
    assert hashed == ["key"]
    monkeypatch.setattr(module, "import_module", lambda name: {}[name])  # not installed
    module._load_torch_and_triton(gpu=True)


def test_a_machine_without_a_driver_is_none_the_worse() -> None:
    code = (
        "import sys; from aerial_gym.interop.preload import preload; [each.join() for each in preload('auto')]; "
        "assert 'torch' not in sys.modules and 'warp' not in sys.modules; import torch; assert torch.ones(2).sum() == 2"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_what_is_imported_beside_does_not_import_torch() -> None:
    code = (
        "import sys; from aerial_gym.interop.preload import import_without_torch; import_without_torch(); "
        "assert 'warp' in sys.modules and 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


CODE = """
import torch
from aerial_gym.interop.rows import RowFunction
RowFunction(lambda a: 2.0 * a, (torch.zeros(2, 3),))(torch.zeros(2, 3))
"""


@pytest.mark.slow
def test_a_compilation_is_told_once_per_machine(tmp_path: Path) -> None:
    environment = {"WARP_CACHE_PATH": str(tmp_path), "PATH": "", "PYTHONPATH": ":".join(sys.path)}
    run = partial(subprocess.run, capture_output=True, text=True, env=environment, check=True)
    said = [run([sys.executable, "-c", CODE]) for _ in range(2)]
    lines = said[0].stderr.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("compiled aerial_gym_rows_")
    assert " for cpu in " in lines[0]
    assert f"kept in {tmp_path}" in lines[0]
    assert ([each.stdout for each in said], said[1].stderr) == (["", ""], "")


def test_what_is_no_compilation_is_left_out(caplog: pytest.LogCaptureFixture) -> None:
    log = KernelLog()
    for message in ("Warp 1.19.0 initialized:", "Module a 1234abc load on device 'cpu' took 3.00 ms  (cached)"):
        log.info(message)
    assert caplog.text == ""
    log.info("Module a 1234abc load on device 'cuda:0' took 1250.00 ms  (compiled)")
    log.info("    Module b 1234abc load on device 'cuda:0' took 250.00 ms  (compiled)")
    assert "compiled a for cuda:0 in 1.2 s; once for this machine, kept in" in caplog.text
    assert caplog.messages[1] == "compiled b for cuda:0 in 0.2 s"


def threads() -> list[int]:
    """Return the number of threads of each linear-algebra library, and of torch as the last."""
    return [library["num_threads"] for library in threadpool_info()] + [torch.get_num_threads()]


def test_torch_and_linear_algebra_run_on_one_thread_inside_and_as_before_after_it() -> None:
    np.testing.assert_allclose(solve_triangular(np.eye(2), np.ones(2)), 1.0)
    torch.set_num_threads(2)
    before = threads()
    try:
        with one_thread():
            assert set(threads()) == {1}
            raise KeyError
    except KeyError:
        pass
    assert len(before) >= 3
    assert threads() == before


def test_a_home_that_is_missing_or_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise PermissionError(13, "Permission denied", "/home/x/.cache/warp")

    with monkeypatch.context() as patch:
        patch.setattr(wp, "init", refuse)
        assert_refused(StorageError, "/home/x/.cache/warp.*WARP_CACHE_PATH", start_warp)
    for name in ("WARP_CACHE_PATH", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    assert_refused(StorageError, "WARP_CACHE_PATH", start_warp)


def test_a_cache_that_is_empty_and_read_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert_refused(StorageError, "WARP_CACHE_PATH", start_warp)
    (tmp_path / "wm_kernels").mkdir()  # compiled before, on an image that is read-only now
    start_warp()
