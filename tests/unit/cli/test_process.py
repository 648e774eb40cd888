"""Start of a command's process: its clock, and the folder for compiled Python code."""

import importlib.util
import sys
import time
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from aerial_gym.cli import process


@pytest.fixture
def installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation of PyTorch without compiled code, for a process that keeps none; returns its ``__init__.py``."""
    package = tmp_path / "site" / "torch" / "__init__.py"
    package.parent.mkdir(parents=True)
    package.touch()
    monkeypatch.setattr(process, "find_spec", lambda _: ModuleSpec("torch", None, origin=str(package)))
    monkeypatch.setattr(sys, "pycache_prefix", None)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    return package


def test_code_is_kept_where_the_installation_gets_none_or_cannot_be_written(
    installation, tmp_path, monkeypatch
) -> None:
    process.cache_bytecode()
    assert (sys.pycache_prefix, sys.dont_write_bytecode) == (str(tmp_path / "caches/aerial_gym/bytecode"), False)
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(sys, "pycache_prefix", None)
    monkeypatch.setattr(process.os, "access", lambda *_: False)
    process.cache_bytecode()
    assert sys.pycache_prefix is not None


@pytest.mark.parametrize("case", ["compiled", "python writes it", "folder of the user", "no torch"])
def test_settings_of_python_stay_otherwise(case: str, installation: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if case == "compiled":
        compiled = Path(importlib.util.cache_from_source(str(installation)))
        compiled.parent.mkdir()
        compiled.touch()
    elif case == "python writes it":
        monkeypatch.setattr(sys, "dont_write_bytecode", False)
    elif case == "folder of the user":
        monkeypatch.setattr(sys, "pycache_prefix", "/elsewhere")
    else:
        monkeypatch.setattr(process, "find_spec", lambda _: None)
    before = sys.pycache_prefix, sys.dont_write_bytecode
    process.cache_bytecode()
    assert (sys.pycache_prefix, sys.dont_write_bytecode) == before


def test_a_command_counts_from_the_start_of_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "cache_bytecode", lambda: None)
    monkeypatch.setattr(process, "_started", None)
    monkeypatch.setattr(sys, "argv", ["aerial-gym", "list"])
    assert process.start_time() == pytest.approx(time.perf_counter(), abs=0.1)
    used = time.process_time()
    process.start_clock_and_preload()
    assert process.start_time() == pytest.approx(time.perf_counter() - used, abs=0.1)


@pytest.mark.parametrize(
    ("given", "device"),
    [
        ([], "auto"), (["--device", "cpu"], "cpu"), (["--device=cuda:1", "--resume"], "cuda:1"), (["--device"], "auto"),
        (["--resume"], "cpu"), (["--config=a.yaml"], "cpu"),
    ],
)  # fmt: skip
def test_a_training_loads_libraries_for_its_device(given, device, monkeypatch) -> None:
    loaded: list[str] = []
    monkeypatch.setattr(process, "cache_bytecode", lambda: None)
    monkeypatch.setattr(process, "_started", None)
    monkeypatch.setattr(process, "preload", loaded.append)
    monkeypatch.setattr(sys, "argv", ["aerial-gym", "train", *given])
    process.start_clock_and_preload()
    monkeypatch.setattr(sys, "argv", ["aerial-gym", "train", *given, "--help"])
    process.start_clock_and_preload()
    assert loaded == [device]
