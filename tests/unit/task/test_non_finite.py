"""Rows that are not finite: they end, they are counted and named, their neighbours do not notice, and they can be looked at."""

import csv
import logging
from dataclasses import replace
from itertools import product
from math import inf, isfinite, nan
from pathlib import Path

import pytest
import torch

from aerial_gym import SIMS, task_registry
from aerial_gym.cli.main import main
from aerial_gym.errors import ConfigError
from aerial_gym.robots.finite_watch import KEPT_STEPS
from aerial_gym.robots.non_finite_rows import NonFinite
from aerial_gym.task import OBSERVATIONS, REWARDS, Task
from tests.repetitions import frequent_values
from tests.unit.task.hover import build_task

BAD = 2
"""The row that is spoilt, of four."""


def make(backend: str = "auto") -> Task:
    cfg = task_registry.get("position_setpoint_task")
    return build_task(replace(cfg, sim=replace(SIMS.get(cfg.sim), backend=backend)), 4, seed=3)


def check(task: Task, actions: torch.Tensor, twin: Task) -> None:
    """Step both tasks; ``twin`` is healthy. The spoilt row ends with a finite reward; the others are those of the twin."""
    result = task.step(actions)
    healthy = twin.step(torch.zeros(4, 4))
    obs, reward, terminated, truncated, info = result
    assert info["non_finite"].tolist() == [False, False, True, False]
    assert terminated.tolist() == [False, False, True, False]
    assert not truncated.any()
    assert reward[BAD] == -20.0
    for tensor in (obs["observations"], reward, info["final_observation"], info["episode_return"], info["distance"]):
        assert tensor.isfinite().all()
    rest = torch.arange(4) != BAD
    torch.testing.assert_close(obs["observations"][rest], healthy[0]["observations"][rest], rtol=0.0, atol=0.0)
    torch.testing.assert_close(reward[rest], healthy[1][rest], rtol=0.0, atol=0.0)
    assert all(task.env.gtd[key].isfinite().all() for key in ("robot_position", "robot_linvel", "rotor_speed"))
    assert task.env.gtd["non_finite"].sum() == 0  # forgotten with the reset
    after = task.step(torch.zeros(4, 4))
    assert not after[4]["non_finite"].any()
    assert after[0]["observations"].isfinite().all()
    assert task.num_non_finite == 1


@pytest.mark.parametrize(
    ("value", "backend"), frequent_values(product((nan, inf), ("warp", "torch")), [(nan, "torch"), (inf, "warp")])
)
def test_a_bad_action_or_state_ends_its_row_alone(backend: str, value: float, caplog: pytest.LogCaptureFixture) -> None:
    for label in (NonFinite.ACTION, NonFinite.STATE):
        task, twin, actions = make(backend), make(backend), torch.zeros(4, 4)
        task.reset()
        twin.reset()
        if label is NonFinite.ACTION:
            actions[BAD, 1] = value
        else:
            task.env.gtd["robot_linvel"][BAD, 0] = value
        with caplog.at_level(logging.WARNING):
            check(task, actions, twin)
        named = [r.getMessage() for r in caplog.records if "not finite" in r.getMessage()]
        assert len(named) == 1
        assert named[0].startswith("environment 2, episode 0, step 1: ")
        assert str(label.name).lower() in named[0]
        caplog.clear()


def test_a_bad_reward_or_observation_ends_its_row(monkeypatch, caplog) -> None:
    reward, term = REWARDS.get("distance_bell"), OBSERVATIONS.get("position_error_world")

    def spoil(target_position, robot_position, *, height, width):
        worth = reward.value(target_position, robot_position, height=height, width=width)
        return torch.where((robot_position[:, 2] > 1.0) & (robot_position[:, 2] < 7.0), nan, worth)

    def break_rows(robot_position):
        return torch.where(robot_position[:, 2:] > 1.0, inf, robot_position)

    for label, registry, entry in (
        (NonFinite.REWARD, REWARDS, replace(reward, value=spoil)),
        (NonFinite.OBSERVATION, OBSERVATIONS, replace(term, value=break_rows)),
    ):
        with monkeypatch.context() as patch, caplog.at_level(logging.WARNING):
            patch.setitem(registry._entries, entry.name, entry)
            task = make()
            task.reset()
            task.env.gtd["robot_position"].zero_()
            task.env.gtd["robot_position"][BAD, 2] = 4.0
            _, reward_of, terminated, _, info = task.step(torch.zeros(4, 4))
        assert info["non_finite"].tolist() == [False, False, True, False]
        assert terminated[BAD]
        assert reward_of.isfinite().all()
        assert info["final_observation"].isfinite().all()
        assert str(label.name).lower() in caplog.text
        caplog.clear()


def test_the_watch_keeps_the_last_steps_and_play_shows_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with make() as task:
        with pytest.raises(ConfigError, match=r"Call task.watch\(\) before the first reset"):
            task.dump(tmp_path / "dump.csv")
        task.watch()
        task.reset()
        positions = []
        for step in range(1, KEPT_STEPS + 41):
            actions = torch.full((4, 4), 0.001 * step)
            if step in (KEPT_STEPS + 30, KEPT_STEPS + 33):
                actions[BAD, 3] = nan
            task.step(actions)
            positions.append(task.env.gtd["robot_position"][BAD].tolist())
        assert task.dump(tmp_path / "dump.csv") == 2
    with (tmp_path / "dump.csv").open() as file:
        rows = list(csv.DictReader(file))
    first, second = rows[:KEPT_STEPS], rows[KEPT_STEPS:]
    assert len(second) == 3
    assert {row["env"] for row in rows} == {"2"}
    assert [int(row["episode_step"]) for row in first] == list(range(31, KEPT_STEPS + 31))
    assert [int(row["episode_step"]) for row in second] == [1, 2, 3]
    assert float(first[-1]["t"]) == 0.0
    assert all(isfinite(float(row["action_4"])) for row in first[:-1])
    assert first[-1]["action_4"] == first[-1]["command_4"] == "nan"
    for row, action in ((first[0], 0.031), (second[0], 0.001 * (KEPT_STEPS + 31))):
        assert float(row["action_1"]) == pytest.approx(action)
    for k in range(KEPT_STEPS - 1):  # the last step is followed by a reset
        assert [float(first[k][axis]) for axis in ("p_x", "p_y", "p_z")] == pytest.approx(positions[30 + k])
    assert main(["play", "--replay", str(tmp_path / "dump.csv")]) == 0
    shown = capsys.readouterr()
    assert "environment 2, step 94 of its episode: action" in shown.err
    assert shown.out == (tmp_path / "dump.csv").read_text().replace("\r\n", "\n")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    assert main(["play", "--replay", str(tmp_path / "other.csv")]) == 2
    assert "is no dump of a watch" in capsys.readouterr().err
