"""A task of a user's own: in one file, as the example and the page show it."""

import sys
from pathlib import Path

import pytest
import torch
import yaml

from aerial_gym import task_registry
from aerial_gym.config import build
from aerial_gym.config.task import TaskCfg
from aerial_gym.errors import ConfigError, DuplicateNameError, UnknownNameError
from tests.unit.task.hover import build_task

ROOT = Path(__file__).parents[4]
EXAMPLE = f"{ROOT / 'examples' / 'custom_task.py'}:FIGURE_EIGHT"


def test_the_example_flies_and_learns_from_its_own_terms() -> None:
    task = task_registry.make_task(EXAMPLE, num_envs=3, device="cpu", seed=0)
    assert "figure_eight_task" in task_registry
    obs, _ = task.reset()
    assert obs["observations"].shape == (3, 3 + 3 + 6 + 3 + 3 + 4)
    assert obs["critic"].shape == (3, 3 + 3 + 6 + 3 + 3 + 4 + 1)
    assert task.reward_names == ("near", "distance", "nose", "calm", "crash")
    for _ in range(3):
        obs, reward, *_ = task.step(torch.zeros(3, 4))
    assert reward.isfinite().all()
    assert all(rows.reason is None and not rows.apart for rows in (task._judge.rows, task._observer.rows))
    attitude, way = task.env.gtd["robot_orientation"], task.values["target_velocity"]
    x, y, z, w = attitude.unbind(-1)
    nose = torch.stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)), dim=-1)
    cosine = ((nose * way).sum(-1) / way.norm(dim=-1)).clamp_min(0.0)
    result = task_registry.make_task(EXAMPLE, num_envs=3, device="cpu")._judge._rewards["nose"][0].evaluate(task.values)
    torch.testing.assert_close(result, cosine)


def test_a_file_is_run_once() -> None:
    assert task_registry.get(EXAMPLE) is task_registry.get(EXAMPLE)
    with pytest.raises(UnknownNameError, match="has no attribute 'SQUARE'. Give it as file.py:Name"):
        task_registry.get(EXAMPLE.replace("FIGURE_EIGHT", "SQUARE"))
    with pytest.raises(UnknownNameError, match="nowhere.py: no such file. Give it as file.py:Name"):
        task_registry.get("nowhere.py:TASK")


def test_a_file_that_fails_can_be_mended(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "from aerial_gym.task import REWARDS\nREWARDS.term('still')(lambda robot_position: robot_position)\n"
    )
    with pytest.raises(DuplicateNameError, match="reward term 'still' is registered already"):
        task_registry.get(f"{path}:TASK")
    path.write_text("TASK = 3\n")
    with pytest.raises(ConfigError, match="must be a TaskCfg, or a subclass of Task"):
        task_registry.get(f"{path}:TASK")
    assert not [name for name in sys.modules if name == "mine"]


def test_the_task_of_the_page_flies() -> None:
    text = (ROOT / "docs" / "guides" / "own_task.md").read_text()
    block = text.split("```yaml\n")[1].split("```")[0]
    cfg = build(TaskCfg, yaml.safe_load(block), where="docs/guides/own_task.md")
    task = build_task(cfg, 2)
    obs, _ = task.reset()
    assert obs["observations"].shape == (2, 3 + 4 + 3 + 9)
    task.step(torch.zeros(2, 4))
