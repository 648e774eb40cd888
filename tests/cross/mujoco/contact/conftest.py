"""Robots of these tests."""

from pathlib import Path

import pytest

from tests.cross.mujoco.contact.on_legs import FILE, LEGS


@pytest.fixture
def on_legs(tmp_path: Path) -> str:
    (tmp_path / "on_legs.yaml").write_text(FILE.replace("LEGS", LEGS))
    return str(tmp_path / "on_legs.yaml")
