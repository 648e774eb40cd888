"""The curriculum: when the level goes up and down, where it stops, and that obstacles follow it."""

from dataclasses import replace

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.config.task import CurriculumCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task.curriculum import next_level
from tests.refusals import assert_refused
from tests.unit.task.hover import begin
from tests.unit.task.test_navigation import make

LEVELS = {"min_level": 15, "max_level": 20, "raise_by": 2, "lower_by": 1}
CFG = CurriculumCfg(**LEVELS, check_after=10, raise_above=0.7, lower_below=0.6)


def decide(level: int, finished: int, succeeded: int, cfg: CurriculumCfg = CFG) -> tuple[int, int, int]:
    given = (torch.tensor([value], dtype=torch.int32) for value in (level, finished, succeeded))
    level_now, finished_now, succeeded_now = (int(value) for value in next_level(*given, cfg))
    return level_now, finished_now, succeeded_now


@pytest.mark.parametrize(("before", "after"), [
    ((17, 10, 8), (19, 0, 0)),  # 80 %: up by 2
    ((17, 10, 7), (17, 0, 0)),  # exactly 70 %: stays
    ((17, 10, 6), (17, 0, 0)),  # exactly 60 %: stays
    ((17, 10, 5), (16, 0, 0)),  # 50 %: down by 1
    ((17, 12, 9), (19, 0, 0)),  # several episodes ended in one step
    ((17, 9, 9), (17, 9, 9)),  # not yet
    ((17, 9, 0), (17, 9, 0)),
    ((17, 0, 0), (17, 0, 0)),
    ((19, 10, 10), (20, 0, 0)),  # the highest
    ((20, 10, 10), (20, 0, 0)),
    ((15, 10, 0), (15, 0, 0)),  # the lowest
])  # fmt: skip
def test_the_level_moves_at_its_thresholds_and_stays_in_its_limits(before, after) -> None:
    assert decide(*before) == after


def test_a_held_level_stays() -> None:
    held = replace(CFG, raise_by=0, lower_by=0)
    assert decide(17, 10, 10, held) == decide(17, 10, 0, held) == (17, 0, 0)


HOVER = torch.tensor([-1.0, 0.0, 0.0, 0.0])  # Speed 0


def rows_present(task: Task) -> list[int]:
    return (task.env.gtd["obstacle_position"][..., 2] > -500.0).sum(dim=1).tolist()


def test_the_number_of_obstacles_follows_the_successes_from_the_reset_in_which_they_are_counted() -> None:
    """All episodes last 3 steps and succeed (any distance is near enough): 15, 17, 19, 20 rows, and no more."""
    task = make(curriculum=replace(CFG, check_after=6), episode_len_steps=3, success_radius=100.0)
    task.reset()
    seen = [(int(task.env.gtd["curriculum_level"]), rows_present(task))]
    for step in range(1, 13):
        *_, info = task.step(HOVER.expand(6, 4))
        assert info["successes"].all() == (step % 3 == 0)
        if step % 3 == 0:
            seen.append((int(task.env.gtd["curriculum_level"]), rows_present(task)))
    assert [level for level, _ in seen] == [15, 17, 19, 20, 20]
    assert [rows for _, rows in seen] == [[level] * 6 for level, _ in seen]
    assert int(task.env.gtd["num_obstacles_in_env"]) == 20 - 9


def test_failures_lower_it_and_the_difficulty_is_the_share_of_the_way() -> None:
    task = make(curriculum=replace(CFG, check_after=6, start_level=17), episode_len_steps=2, success_radius=1e-3)
    task.reset()
    result = [float(task.values["difficulty"])]
    for _ in range(6):
        task.step(HOVER.expand(6, 4))
        result.append(float(task.values["difficulty"]))
    assert result == pytest.approx([0.4, 0.4, 0.2, 0.2, 0.0, 0.0, 0.0])


def test_processes_that_learn_together_decide_on_the_episodes_of_all() -> None:
    task = make(curriculum=replace(CFG, check_after=12), episode_len_steps=1, success_radius=100.0)
    task.curriculum.of_all = lambda counts: counts + torch.tensor([6, 0])
    task.reset()
    task.step(HOVER.expand(6, 4))
    assert task.curriculum.state() == {"level": 15, "finished": 0, "succeeded": 0}
    task.curriculum.of_all = lambda counts: counts + torch.tensor([6, 6])
    task.step(HOVER.expand(6, 4))
    assert task.curriculum.state() == {"level": 17, "finished": 0, "succeeded": 0}


def test_a_reset_keeps_the_level_and_a_seed_begins_anew() -> None:
    task = make(curriculum=replace(CFG, check_after=6), episode_len_steps=1, success_radius=100.0)
    task.reset()
    task.step(HOVER.expand(6, 4))
    task.reset()
    assert rows_present(task) == [17] * 6
    task.reset(seed=0)
    assert rows_present(task) == [15] * 6


def test_a_state_continues_where_it_was() -> None:
    task, other = (make(curriculum=replace(CFG, check_after=8), episode_len_steps=1) for _ in range(2))
    task.reset()
    task.step(HOVER.expand(6, 4))
    state = task.curriculum.state()
    assert state == {"level": 15, "finished": 6, "succeeded": 0}
    other.curriculum.load(state | {"level": 18})
    assert float(other.values["difficulty"]) == pytest.approx(0.6)
    other.reset()
    assert rows_present(other) == [18] * 6
    other.step(HOVER.expand(6, 4))
    assert other.curriculum.state() == {"level": 17, "finished": 0, "succeeded": 0}
    assert_refused(ConfigError, "curriculum level 30: must lie in 15", other.curriculum.load, state | {"level": 30})


@pytest.mark.parametrize(("changes", "message"), [
    ({"min_level": 20}, "min_level = 20: must be >= 0 and below max_level = 20"),
    ({"min_level": -1}, "min_level = -1"),
    ({"check_after": 0}, "CurriculumCfg.check_after = 0: must be >= 1"),
    ({"lower_below": 0.8}, "lower_below = 0.8: must be 0 to raise_above = 0.7"),
    ({"raise_above": float("nan")}, "raise_above = nan"),
    ({"raise_above": 1.1}, "raise_above = 1.1"),
    ({"raise_by": -1}, "CurriculumCfg.raise_by = -1: must be >= 0"),
    ({"lower_by": -2}, "CurriculumCfg.lower_by = -2: must be >= 0"),
    ({"start_level": 14}, "CurriculumCfg.start_level = 14: must lie in 15 to 20"),
])  # fmt: skip
def test_impossible_curricula_are_refused(changes: dict, message: str) -> None:
    assert_refused(ConfigError, message, replace, CFG, **changes)


def test_a_curriculum_and_a_level_must_fit_the_environment() -> None:
    assert_refused(ConfigError, "max_level = 50: this environment has 44", make, curriculum=replace(CFG, max_level=50))
    assert_refused(ConfigError, "min_level = 5: this environment always", make, curriculum=replace(CFG, min_level=5))
    cfg = task_registry.get("navigation_task")
    ends = {name: end for name, end in cfg.terminations.items() if end.kind != "success"}
    assert_refused(ConfigError, "curriculum: needs a termination of kind success", replace, cfg, terminations=ends)
    with task_registry.make_task("navigation_task", num_envs=2, device="cpu", level=30) as task:
        assert (task.cfg.curriculum.raise_by, task.cfg.curriculum.lower_by) == (0, 0)
        task.reset()
        assert rows_present(task) == [30, 30]
    assert_refused(ConfigError, "start_level = 50: must lie", task_registry.make_task, "navigation_task", level=50)
    assert_refused(ConfigError, "level = 3: task", task_registry.make_task, "position_setpoint_task", level=3)


def test_an_episode_is_replayed_alone_with_the_level_that_it_had() -> None:
    many = begin("navigation_task", 3, seed=1)
    many.curriculum.load({"level": 23, "finished": 0, "succeeded": 0})
    many.env.gtd["sim_steps"].fill_(many.cfg.episode_len_steps)
    many.step(torch.zeros(3, 4))  # all episodes end, and others begin
    level = int(many.env.gtd["curriculum_level"])
    assert many.env.gtd["episodes"].tolist() == [1, 1, 1]
    numbers = {"num_envs": 1, "device": "cpu", "seed": 1, "first_env": 2, "first_episode": 1}
    alone = task_registry.make_task("navigation_task", **numbers, level=level)
    alone.reset()
    for key in ("robot_position", "obstacle_position", "env_bounds_max"):
        assert torch.equal(alone.env.gtd[key][0], many.env.gtd[key][2]), key
    assert_refused(ConfigError, "Give level, which stood", task_registry.make_task, "navigation_task", **numbers)


def test_without_obstacles_the_level_is_the_difficulty_alone(tmp_path) -> None:
    """A task file of one's own: every episode of 3 steps succeeds, and after 4 of them the level rises."""
    file = tmp_path / "own.yaml"
    file.write_text(
        "summary: own\nextends: position_setpoint_task\nepisode_len_steps: 3\nterminations:\n"
        "  there: {term: at_target, kind: success, when: at_end, params: {radius: 9.0}}\n"
        "curriculum: {min_level: 1, max_level: 5, check_after: 4, raise_above: 0.7, lower_below: 0.3,\n"
        "  raise_by: 1, lower_by: 1}\n"
    )
    with task_registry.make_task(str(file), num_envs=4, device="cpu") as task:
        task.reset()
        for _ in range(6):
            task.step(HOVER.expand(4, 4))
        assert int(task.env.gtd["curriculum_level"]) == 3
        assert float(task.values["difficulty"]) == 0.5
    with task_registry.make_task(str(file), num_envs=4, device="cpu", level=5) as task:
        assert float(task.values["difficulty"]) == 1.0
