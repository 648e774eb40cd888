"""Tasks by name, from a file, and from a module of the user's own; and what ``make_task`` may replace in them."""

from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym import task_registry
from aerial_gym.config import dump_yaml
from aerial_gym.errors import ConfigError, UnknownNameError

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


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("nowhere.yaml", ConfigError, "nowhere.yaml: no such file"),
        ("no_such_module:Task", UnknownNameError, "no_such_module:Task.*No module named"),
        ("json:Task", UnknownNameError, "has no attribute 'Task'. Give it as module:Name"),
        ("json:JSONDecoder", ConfigError, "must be a TaskCfg, or a subclass of Task that has one as its cfg"),
    ],
)
def test_what_is_no_task_is_refused(name: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        task_registry.get(name)


def test_sim_environment_and_robot_can_be_replaced() -> None:
    task = task_registry.make_task(
        "position_setpoint_task", num_envs=2, device="cpu", sim="base_sim_2ms", env="landing_env", robot="tinyprop"
    )
    assert task.env.dt == pytest.approx(0.002 * task.env.cfg.physics_steps_per_env_step)
    assert (task.cfg.sim, task.cfg.env, task.cfg.robot) == ("base_sim_2ms", "landing_env", "tinyprop")
    with pytest.raises(UnknownNameError, match="base_sim_2ms"):
        task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", sim="base_sim_1ms")
