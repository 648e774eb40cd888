"""Warp's start where it cannot keep compiled kernels: the message names the variable that says where."""

import os
from pathlib import Path

import pytest
import warp as wp

from aerial_gym.errors import StorageError
from aerial_gym.interop import start_warp


def test_a_home_that_cannot_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise PermissionError(13, "Permission denied", "/home/x/.cache/warp")

    monkeypatch.setattr(wp, "init", refuse)
    with pytest.raises(StorageError, match="/home/x/.cache/warp.*WARP_CACHE_PATH"):
        start_warp()


def test_a_cache_that_is_empty_and_read_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    start_warp()
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(StorageError, match="WARP_CACHE_PATH"):
        start_warp()
    (tmp_path / "wm_kernels").mkdir()  # compiled before, on an image that is read-only now
    start_warp()


def test_a_user_without_a_home(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WARP_CACHE_PATH", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    with pytest.raises(StorageError, match="WARP_CACHE_PATH"):
        start_warp()
