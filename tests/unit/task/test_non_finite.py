"""Rows that are not finite end, are counted and named; tasks that cannot work, or are closed, say so."""

import csv
import logging
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from math import inf, isfinite, nan
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym import SIMS, SimBuilder, task_registry
from aerial_gym.cli.main import main
from aerial_gym.errors import CapabilityError, ClosedError, ConfigError, ShapeError
from aerial_gym.rl_training import GymnasiumVectorEnv
from aerial_gym.robots.finite_watch import KEPT_STEPS, NonFinite
from aerial_gym.task import OBSERVATIONS, REWARDS, Task
from tests.refusals import assert_refused
from tests.repetitions import frequent_values
from tests.unit.task.hover import begin, build_task

BAD = 2  # The row that is spoilt, of four


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

    def break_rows(target_position, robot_position):
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
        assert_refused(ConfigError, r"Call task.watch\(\) before the first reset", task.dump, tmp_path / "dump.csv")
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
    assert (len(second), {row["env"] for row in rows}) == (3, {"2"})
    assert [int(row["episode_step"]) for row in first] == list(range(31, KEPT_STEPS + 31))
    assert ([int(row["episode_step"]) for row in second], float(first[-1]["t"])) == ([1, 2, 3], 0.0)
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


NAMES = {"sim_name": "base_sim", "env_name": "empty_env", "robot_name": "base_quadrotor"}
NAMES |= {"controller_name": "lee_position_control"}


def test_terms_that_return_another_shape_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reward (E, 1) would be spread to (E, E), a wider term would shift every entry after it."""
    reward, term = REWARDS.get("distance_bell"), OBSERVATIONS.get("position_error_world")

    def replace_reward(change: Callable[[Tensor], object]) -> object:
        return replace(reward, value=lambda robot_position, *, height, width: change(robot_position * height * width))

    wide = replace(term, value=lambda a, b: torch.cat((a, b), dim=-1))
    column = r"reward 'near' \(distance_bell\): returns \(4, 1\) .*\(E,\) = \(4,\)"
    whole = r"returns \(4,\) torch.int32, needs .* floating point"
    for registry, entry, message in (
        (REWARDS, replace_reward(lambda rows: rows[:, :1]), column),
        (REWARDS, replace_reward(lambda rows: rows[:, 0].int()), whole),
        (REWARDS, replace_reward(lambda rows: float(len(rows))), "returns a float, needs a tensor"),
        (OBSERVATIONS, wide, r"observation term .*returns \(4, 6\) .*\(E, width\) = \(4, 3\)"),
    ):
        with monkeypatch.context() as patch:
            patch.setitem(registry._entries, entry.name, entry)
            with pytest.raises(ConfigError, match=message):
                task_registry.make_task("position_setpoint_task", num_envs=4, device="cpu")


@pytest.mark.parametrize(("count", "message"), [(10**10, "must be at least 1"), (2**31 - 1, "memory of cpu")])
def test_counts_that_nothing_holds_are_refused(count: int, message: str) -> None:
    with pytest.raises((ConfigError, CapabilityError), match=message):
        SimBuilder().build_env(**NAMES, num_envs=count, device="cpu")


def test_whatever_is_used_after_close_says_so() -> None:
    task = task_registry.make_task("position_setpoint_task", num_envs=4, device="cpu")
    adapter, actions = GymnasiumVectorEnv(task), torch.zeros(4, 4)
    task.reset()
    adapter.close()
    task.close()  # a second time does nothing
    env = task.env
    assert not hasattr(env, "robot_manager")
    tasks = (task.reset, lambda: task.step(actions), lambda: task.reset(seed=1))
    envs = (env.reset, env.render, lambda: env.step(actions))
    for use in (*tasks, *envs, adapter.reset, lambda: adapter.step(actions)):
        assert_refused(ClosedError, "this simulation is closed. Build a new one", use)


@pytest.mark.parametrize("width", [1, 3, 5])
@pytest.mark.parametrize("name", ["position_setpoint_task", "position_setpoint_task_sim2real_px4"])
def test_actions_of_another_width_are_refused(name: str, width: int) -> None:
    with begin(name, 4) as task, pytest.raises(ShapeError, match=r"expected \(E, V\) = \(4, 4\)"):
        task.step(torch.zeros(4, width))
