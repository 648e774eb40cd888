"""Caches are listed with their size and cleared by name."""

import json
from pathlib import Path

import pytest

from aerial_gym.cli import cache
from aerial_gym.cli.cache import Cache, find_caches
from tests.integration.commands import run


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Path]:
    """Return two folders with a file of 3 bytes each, known as caches."""
    folders = {name: tmp_path / name for name in ("kernels", "bytecode")}
    made = {}
    for name, folder in folders.items():
        file = folder / "inner" / "file"
        file.parent.mkdir(parents=True)
        file.write_text("abc", encoding="utf-8")
        made[name] = Cache(content=name, folder=folder, clear=file.unlink)
    monkeypatch.setattr(cache, "find_caches", lambda: made)
    return folders


def test_caches_have_folders_and_sizes(folders: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "cache", "list", "--json")
    assert status == 0
    expected = {"folder": str(folders["kernels"]), "content": "kernels", "num_files": 1, "size_bytes": 3}
    assert json.loads(out)["kernels"] == expected
    assert "1 files" in run(capsys, "cache", "list")[1]


def test_caches_are_cleared_by_name(folders: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    status, _, told = run(capsys, "cache", "clear", "kernel")
    assert (status, told) == (2, "aerial-gym: no cache 'kernel'. Did you mean 'kernels'? Known: kernels, bytecode\n")
    assert (
        run(capsys, "cache", "clear", "kernel", "BAD")[2].splitlines()[2]
        == "  no cache 'BAD'. Known: kernels, bytecode"
    )
    assert run(capsys, "cache", "clear", "kernels")[0] == 0
    assert [(folder / "inner" / "file").exists() for folder in folders.values()] == [False, True]
    assert run(capsys, "cache", "clear")[0] == 2  # the file of kernels is gone already
    folders["kernels"].joinpath("inner", "file").touch()
    assert run(capsys, "cache", "clear")[0] == 0
    assert not folders["bytecode"].joinpath("inner", "file").exists()


def test_the_folders_are_those_of_warp_and_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    bytecode = tmp_path / "aerial_gym" / "bytecode"
    bytecode.mkdir(parents=True)
    caches = find_caches()
    assert caches["bytecode"].folder == bytecode
    assert caches["kernels"].folder.is_dir()
    caches["bytecode"].clear()
    assert not bytecode.exists()
    assert caches["bytecode"].entry()["num_files"] == 0
