"""Tasks for reinforcement learning."""

from aerial_gym.task.catalog import TaskRegistry, task_registry
from aerial_gym.task.task import Task

__all__ = ["Task", "TaskRegistry", "task_registry"]
