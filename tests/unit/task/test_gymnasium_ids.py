"""Gymnasium's ids of tasks: the rule, and when they are registered."""

import logging
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

from aerial_gym.task import task_registry
from aerial_gym.task.gymnasium_ids import gymnasium_id

OLD = gymnasium.__version__.startswith("0.")  # It reads entry points
ROOT = Path(__file__).parents[3]


def test_an_id_is_made_of_the_words_of_a_name() -> None:
    for name, known in (
        ("position_setpoint_task", "aerial_gym/PositionSetpoint-v0"),
        ("position_setpoint_task_sim2real_px4", "aerial_gym/PositionSetpointSim2realPx4-v0"),
        ("hold", "aerial_gym/Hold-v0"),
    ):
        assert gymnasium_id(name) == known


def test_every_task_has_an_id_of_its_own() -> None:
    ids = {gymnasium_id(name) for name in task_registry.names()}
    assert len(ids) == len(task_registry.names())
    assert ids <= gymnasium.registry.keys()


def test_a_task_of_a_user_has_an_id_unless_that_is_taken(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    monkeypatch.setattr(task_registry, "_entries", dict(task_registry._entries))
    hover = task_registry.get("position_setpoint_task")
    task_registry.register("my_hover_task", hover)
    assert gymnasium.spec("aerial_gym/MyHover-v0").entry_point.endswith(":single.my_hover_task")
    task_registry.register("hover-2", hover)  # no id: Gymnasium would refuse some characters
    with caplog.at_level(logging.WARNING):
        task_registry.register("position_setpoint", hover)
    assert "task 'position_setpoint': Gymnasium's id aerial_gym/PositionSetpoint-v0 is taken" in caplog.text


def count_ids(imports: str, *, entry_points: Path | None = None) -> str:
    """Return the number of ids that a new process knows after these imports, and whether it has imported torch or Warp."""
    code = f"""
import sys
sys.path[:0] = {[str(ROOT), *([] if entry_points is None else [str(entry_points)])]}
import {imports}
import gymnasium
print(sum(name.startswith("aerial_gym/") for name in gymnasium.registry), "torch" in sys.modules, "warp" in sys.modules)
"""
    command = [sys.executable, "-W", "error::UserWarning", "-c", code]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=True).stdout.strip()


@pytest.mark.parametrize("imports", ["gymnasium, aerial_gym", "aerial_gym, gymnasium"])
def test_ids_are_registered_in_either_order_of_imports(imports: str) -> None:
    assert count_ids(imports) == "36 False False"


@pytest.mark.skipif(not OLD, reason="Gymnasium 1 reads no entry points")
def test_gymnasium_finds_the_ids_by_the_entry_point(tmp_path: Path) -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    lines = text.partition('[project.entry-points."gymnasium.envs"]\n')[2].partition("\n\n")[0]
    folder = tmp_path / "ids-1.0.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: ids\nVersion: 1.0\n")
    (folder / "entry_points.txt").write_text("[gymnasium.envs]\n" + lines.replace('"', ""))
    assert count_ids("sys", entry_points=tmp_path) == "36 False False"
