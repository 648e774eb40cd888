"""The doctor reports versions, devices, caches, missing packages and faults, each with its repair."""

import json

import pytest
import torch
from packaging.requirements import Requirement

from aerial_gym.cli import doctor
from aerial_gym.errors import StorageError
from aerial_gym.interop import warp_start
from tests.integration.commands import run


def test_a_working_installation_has_no_faults(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "doctor", "--json")
    report = json.loads(out)
    assert (status, report["faults"]) == (0, [])
    # pip leaves out the local part of PyTorch's CUDA build, such as +cu130
    assert report["versions"]["torch"].partition("+")[0] == torch.__version__.partition("+")[0]
    assert report["devices"][0]["device"] == "cpu"
    assert set(report["caches"]) == {"kernels", "bytecode", "firmware"}
    assert report["extras"]["urdf"] == {"missing": [], "repair": None}
    assert "all" not in report["extras"]
    status, out, _ = run(capsys, "doctor")
    assert (status, out.splitlines()[-1]) == (0, "no faults")


def test_each_fault_and_each_missing_package_has_its_repair(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = {"": (Requirement("numpy>=99"), Requirement("no-such>=1")), "bees": (Requirement("bee>=2"),)}
    monkeypatch.setattr(doctor, "requirements", lambda: rows)
    monkeypatch.setattr(doctor, "extra_packages", rows.__getitem__)
    monkeypatch.setattr(doctor, "_program", lambda *names: {"path": None, "repair": f"install {names[0]}"})
    monkeypatch.setattr(warp_start, "has_gpu_driver", lambda: True)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)

    def refuse() -> None:
        raise StorageError("/: Warp cannot keep compiled kernels there")

    monkeypatch.setattr(doctor, "find_caches", refuse)
    status, out, _ = run(capsys, "doctor", "--json")
    report = json.loads(out)
    repairs = [fault["repair"] for fault in report["faults"]]
    assert status == 1
    assert repairs[:2] == ["pip install 'numpy>=99'", "pip install 'no-such>=1'"]
    assert repairs[2].startswith("run nvidia-smi")
    assert repairs[3].startswith("export WARP_CACHE_PATH=")
    assert report["extras"] == {"bees": {"missing": ["bee>=2"], "repair": "pip install 'aerial-gym[bees]'"}}
    status, out, _ = run(capsys, "doctor")
    assert status == 1
    for told in ("bee>=2", "aerial-gym[bees]", "numpy>=99", "install gcc"):
        assert told in out


def test_a_package_outside_pip_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "requirements", dict)
    assert doctor.examine()["faults"][0]["repair"] == "pip install -e ."
