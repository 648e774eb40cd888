"""Tasks for reinforcement learning."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.task.catalog import TaskRegistry, task_registry
    from aerial_gym.task.task import Task

__all__ = ["Task", "TaskRegistry", "task_registry"]

__getattr__, __dir__ = exports(__name__, __file__)
