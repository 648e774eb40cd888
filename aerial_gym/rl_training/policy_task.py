"""The task that a policy flies, of which simulations with further settings are made."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from aerial_gym.config.changes import Changes, settings_of_run
from aerial_gym.task import Task, task_registry

if TYPE_CHECKING:
    from aerial_gym.config.environment import EnvironmentCfg
    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.config.sim import SimCfg
    from aerial_gym.config.task import TaskCfg


@dataclass(frozen=True, kw_only=True)
class PolicyTask:
    """A task with the names and settings that a policy flies; None is the task's own."""

    name: str  # Task, as ``make_task`` takes it
    robot: str | None
    controller: str | None
    encoder: str | None
    backend: str | None
    level: int | None  # Level at which the curriculum stays; None: its highest
    settings: tuple[str, ...]  # Settings ``KEY=VALUE``
    device: str
    seed: int  # Seed of the starts
    firmware: str | None = None  # Firmware that flies the vehicle in place of the controller

    def configurations(self) -> "tuple[TaskCfg, RobotCfg, EnvironmentCfg, SimCfg]":
        """Return the configurations of task, robot, environment and sim; raise ``ConfigError`` for wrong settings."""
        changes = Changes(self.settings)
        given = {"robot": self.robot, "controller": self.controller}
        cfg, robot, env, sim, _ = task_registry.configurations(self.name, changes, **given)
        changes.finish()
        return cfg, robot, env, sim if self.backend is None else replace(sim, backend=self.backend)

    def make(self, num_envs: int, settings: Sequence[str] = (), *, robot: str | None = None) -> Task:
        """Return a simulation with further settings, or with a robot in place of its own."""
        settings = (*settings_of_run(self.settings, robot=robot, task=None), *settings)
        curriculum = Changes(settings).apply("task", task_registry.get(self.name)).curriculum
        level = curriculum.max_level if self.level is None and curriculum is not None else self.level
        return task_registry.make_task(
            self.name, num_envs=num_envs, device=self.device, seed=self.seed, robot=robot or self.robot,
            controller=self.controller, backend=self.backend, encoder=self.encoder, level=level, settings=settings,
            firmware=self.firmware,
        )  # fmt: skip
