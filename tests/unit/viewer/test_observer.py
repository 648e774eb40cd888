"""One environment of a training on a page."""

import contextlib
import socket
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.training import train
from aerial_gym.task import Task, task_registry

pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.observer import TrainingView
from tests.unit.viewer.client import names_of_updates, page_client


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return listener.getsockname()[1]


def test_page_follows_the_task_and_ends_with_it() -> None:
    port = free_port()
    view = TrainingView(port=port)
    made = task_registry.make_task("position_setpoint_task", num_envs=2, device="cpu", seed=0)
    with made as task, view.follow(task):
        task.reset()
        view.report()
        for _ in range(600):
            with contextlib.suppress(OSError), page_client(port) as line:
                names = names_of_updates(line, "/goal")
                break
            view._ends.wait(0.1)
        else:
            pytest.fail("no page")
    view.close()
    assert "/vehicle/blades" in names
    assert view._page.returncode is not None
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), timeout=5.0)


def test_taken_port_is_refused_before_the_training() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        with pytest.raises(ConfigError, match=str(port)):
            TrainingView(port=port)


class _Note:
    """An observer that counts."""

    def __init__(self) -> None:
        self.reports, self.tasks = 0, list[int]()

    @contextlib.contextmanager
    def follow(self, task: Task) -> Iterator[None]:
        self.tasks.append(task.num_envs)
        yield

    def report(self) -> None:
        assert self.tasks
        self.reports += 1


def test_training_tells_its_observer(tmp_path: Path) -> None:
    cfg = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    note = _Note()
    cfg = replace(cfg, num_envs=16, device="cpu", max_env_steps=2048, max_time_s=None)
    train(cfg, tmp_path / "run", show_progress=False, observer=note)
    assert note.tasks == [16]
    assert note.reports > 0
