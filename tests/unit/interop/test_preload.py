"""Libraries and a GPU's context are loaded beside the imports, or not at all."""

import ctypes
import subprocess
import sys

import pytest

from aerial_gym.interop import preload as module


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
    monkeypatch.setattr(module.ctypes, "CDLL", lambda name: driver)
    module.preload(device).join()
    return driver.calls


@pytest.mark.parametrize(("device", "index"), [(None, 0), ("auto", 0), ("cuda", 0), ("cuda:1", 1)])
def test_the_context_is_that_of_the_device(device: str | None, index: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LOCAL_RANK", raising=False)
    assert run_preload(Driver(), monkeypatch, device) == [("init", 0), ("device", index), "context"]


def test_each_process_of_torchrun_takes_its_own_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert ("device", 1) in run_preload(Driver(), monkeypatch, "cuda")


@pytest.mark.parametrize("device", ["cpu", "cpu:0", "cuda:x", "mps"])
def test_other_devices_have_no_context(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_preload(Driver(), monkeypatch, device) == []


def test_no_context_is_made_without_a_working_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    assert run_preload(Driver(status=100), monkeypatch, "cuda") == [("init", 0)]
    assert run_preload(Driver(), monkeypatch, "cuda:7") == [("init", 0), ("device", 7)]


def test_a_machine_without_a_driver_is_none_the_worse() -> None:
    code = (
        "import sys; from aerial_gym.interop.preload import preload; preload('auto').join(); "
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
