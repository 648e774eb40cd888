"""Every command generator that comes with the package, and how a task makes one."""

from aerial_gym.config.task_terms import CommandCfg
from aerial_gym.env_manager import EnvManager
from aerial_gym.registry.plugins import class_converter
from aerial_gym.task.commands import evader, gates, places, points, polynomial, track
from aerial_gym.task.commands.command import COMMANDS, Command
from aerial_gym.task.terms.term import check_params
from aerial_gym.task.values import Values

__all__ = ["COMMANDS", "evader", "gates", "make_command", "places", "points", "polynomial", "track"]

COMMANDS.accept_plugins(command=class_converter("aerial_gym.task.commands.command:Command"))


def make_command(cfg: CommandCfg | None, values: Values, env: EnvManager) -> Command:
    """Return the generator of a task, with its buffers declared; an idle one for tasks without commands."""
    if cfg is None:
        return Command(values, env)
    cls = COMMANDS.get(cfg.generator)
    return cls(values, env, **check_params(cls, cfg.params, f"command {cfg.generator}"))
