"""Tasks for reinforcement learning: configuration of terms (``docs/guides/own_task.md``)."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.task.catalog import TaskRegistry, task_registry
    from aerial_gym.task.commands.catalog import COMMANDS
    from aerial_gym.task.commands.command import Command
    from aerial_gym.task.task import Task
    from aerial_gym.task.terms.actions import ACTIONS
    from aerial_gym.task.terms.catalog import OBSERVATIONS, REWARDS, TERMINATIONS
    from aerial_gym.task.values import BUFFERS

__all__ = [
    "ACTIONS", "BUFFERS", "COMMANDS", "OBSERVATIONS", "REWARDS", "TERMINATIONS", "Command", "Task", "TaskRegistry",
    "task_registry",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
