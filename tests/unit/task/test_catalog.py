"""Tasks by name, from a file, and from a module of the user's own; and what ``make_task`` may replace in them."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.config import dump_yaml
from aerial_gym.config.task_terms import EndRewardCfg, RewardCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from tests.refusals import assert_refused
from tests.unit.task.hover import begin

MODULE = """
from dataclasses import replace
from aerial_gym import Task, task_registry
SHORT = replace(task_registry.get("position_setpoint_task"), episode_len_steps=7)
class Quiet(Task):
    cfg = SHORT
    def step(self, actions):
        return super().step(0.0 * actions)
NUMBER = 3
"""


def test_a_file_and_a_module_hold_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    short = replace(task_registry.get("position_setpoint_task"), episode_len_steps=5)
    (tmp_path / "short.yaml").write_text(dump_yaml(short))
    (tmp_path / "users_task.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    assert task_registry.get("short.yaml") == short
    assert task_registry.get("users_task:SHORT").episode_len_steps == 7
    made = task_registry.make_task("users_task:Quiet", num_envs=2, device="cpu")
    assert type(made).__name__ == "Quiet"
    assert (made.num_envs, made.cfg.episode_len_steps) == (2, 7)


def test_a_file_may_extend_a_registered_task(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "extends: tracking_task\nepisode_len_steps: 7\nrewards: {calm: null}\nobservations: {policy: [{term: attitude}]}\n"
    )
    base, own = task_registry.get("tracking_task"), task_registry.get(str(file))
    assert (own.episode_len_steps, own.robot) == (7, base.robot)
    assert list(own.rewards) == [name for name in base.rewards if name != "calm"]
    assert [entry.term for entry in own.observations["policy"]] == ["attitude"]


def test_a_file_may_bring_terms_of_its_own(tmp_path: Path) -> None:
    own = "@REWARDS.term()\ndef five_of_its_own(robot_position):\n    return 5.0 + 0.0 * robot_position[:, 0]\n"
    (tmp_path / "my_terms.py").write_text(f"from aerial_gym.task import REWARDS\n{own}")
    task = task_registry.get("position_setpoint_task")
    rewards = {"five": RewardCfg(term="five_of_its_own")}
    file = tmp_path / "mine.yaml"
    file.write_text(dump_yaml(replace(task, imports=("my_terms.py",), rewards=rewards, crash_reward=None)))
    with begin(str(file), 2) as made:
        assert made.step(torch.zeros(2, 4))[1].tolist() == [5.0, 5.0]
    file.write_text(dump_yaml(replace(task, imports=("no_terms.py",))))
    assert_refused(UnknownNameError, r"no_terms.py: no such file", task_registry.get, str(file))


@pytest.mark.parametrize(("name", "error", "message"), [
    ("nowhere.yaml", ConfigError, "nowhere.yaml: no such file"),
    ("no_such_module:Task", UnknownNameError, "no_such_module:Task.*No module named"),
    ("json:Task", UnknownNameError, "has no attribute 'Task'. Give it as module:Name"),
    ("json:JSONDecoder", ConfigError, "must be a TaskCfg, or a subclass of Task that has one as its cfg"),
])  # fmt: skip
def test_what_is_no_task_is_refused(name: str, error: type[Exception], message: str) -> None:
    assert_refused(error, message, task_registry.get, name)


def test_sim_environment_and_robot_can_be_replaced() -> None:
    changes = {"sim": "base_sim_2ms", "env": "landing_env", "robot": "tinyprop"}
    task = task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", **changes)
    assert task.env.dt == pytest.approx(0.002 * task.env.cfg.physics_steps_per_env_step)
    assert (task.cfg.sim, task.cfg.env, task.cfg.robot) == ("base_sim_2ms", "landing_env", "tinyprop")
    with pytest.raises(UnknownNameError, match="base_sim_2ms"):
        task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", sim="base_sim_1ms")


def test_safe_navigation_is_navigation_but_for_what_it_says() -> None:
    task, safe = task_registry.get("navigation_task"), task_registry.get("safe_navigation_task")
    assert task.crash_reward == EndRewardCfg(value=-100.0)
    assert safe.crash_reward == EndRewardCfg(value=-300.0, difficulty_value=-3000.0)
    seen, expected = ([entry.term for entry in cfg.observations["policy"]] for cfg in (safe, task))
    assert [term.replace("log_", "") for term in seen] == expected
    same = {"observations": task.observations, "crash_reward": task.crash_reward}
    assert replace(safe, **same, summary=task.summary, source=task.source) == task


@pytest.mark.parametrize("name", ["position_setpoint_task", "tracking_task"])
def test_a_smooth_task_is_the_task_but_for_its_reward(name: str) -> None:
    task, smooth = task_registry.get(name), task_registry.get(f"smooth_{name}")
    told = {"summary": task.summary, "source": task.source}
    assert replace(smooth, rewards=task.rewards, **told) == task


def test_a_task_may_say_how_flights_begin() -> None:
    """Every attitude, and speeds and rates up to what the task says; the robot's own starts are level and slow."""
    cfg = task_registry.get("recovery_task")
    with begin("recovery_task", 500) as task:
        gtd = task.env.gtd
        up = 1.0 - 2.0 * gtd["robot_orientation"][:, :2].square().sum(dim=-1)
        assert float(up.min()) < -0.9 < 0.9 < float(up.max())
        for key, name in (("robot_linvel", "lin_vel"), ("robot_body_angvel", "ang_vel")):
            low, high = (getattr(cfg.start, f"{name}_{end}")[0] for end in ("low", "high"))
            assert low <= float(gtd[key].min()) < 0.95 * low
            assert 0.95 * high < float(gtd[key].max()) <= high
        assert float(task.target_position.sub(gtd["robot_position"]).abs().max()) <= 0.3 + 1e-6


def test_the_target_of_agile_tracking_accelerates_by_2_g() -> None:
    """Second differences of where it is, over a whole round; their error is (w dt)² / 12, 5e-5 of the largest term."""
    with begin("agile_tracking_task", 4) as task:
        hold = torch.tensor([[-0.375, 0.0, 0.0, 0.0]]).expand(4, -1)  # weight, no turning: nobody leaves in 2.6 s
        seen = []
        for _ in range(260):
            seen.append(task.target_position.clone().double())
            task.step(hold)
        whole = torch.stack(seen)
        pace = (whole[2:] - 2.0 * whole[1:-1] + whole[:-2]) / task.env.dt**2
        largest = pace.norm(dim=-1).max() / 9.80665
        assert float(largest) == pytest.approx(2.0, rel=0.02)


def test_gusts_push_a_vehicle_by_its_drag() -> None:
    """Velocities after one step differ from those in still air by ``d w dt / m``, w of 3 m/s on each axis, d from dy to dx."""
    speeds = []
    for robot in (None, "base_quadrotor_with_drag"):
        with begin("gust_rejection_task", 4096, robot=robot) as task:
            task.step(torch.zeros(4096, 4))
            speeds.append(task.env.gtd["robot_linvel"][:, :2].clone())
    push = (speeds[0] - speeds[1]).std(dim=0) / (3.0 * task.env.dt)
    assert bool((push > 0.35).all())
    assert bool((push < 0.58).all())
