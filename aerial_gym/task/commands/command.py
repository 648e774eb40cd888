"""Interface of command generators: task buffers, pure functions that update them, and draws at reset.

Letters: E environments.
"""

from collections.abc import Callable, Mapping
from typing import TypeVar

from torch import Tensor

from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import ConfigError
from aerial_gym.registry import Registry
from aerial_gym.task.values import Values

TARGET = "target_position"  # Buffer of the point to fly to [m], world, (E, 3), which most generators have


class Command:
    """Base of the generators. A subclass takes its numbers as keyword-only arguments and declares its buffers in ``values``."""

    name = ""  # Under which it is registered
    reads: tuple[str, ...] = ()  # Inputs besides `sim_steps` and `begun`; its own buffers included
    follows_reset = False  # Whether `next_values` are `current_values` again, as a reset changes their inputs
    goal = False  # Whether obstacles that are drawn keep their distance from the target of a new episode

    def __init__(self, values: Values, env: EnvManager) -> None:
        self.values, self.env = values, env

    def current_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the buffers that depend on this instant, after the physics and before rewards and ends. It must not read its
        own results, as it may be called more than once."""
        return {}

    def next_values(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the buffers for the next step; ``begun`` marks environments whose episode has just begun."""
        return self.current_values(values) if self.follows_reset else {}

    def practise(self) -> None:
        """Start training episodes from the next resets on, where these differ from evaluation episodes."""

    def place(self, mask: Tensor) -> None:
        """Move the robots of ``mask``, bool (E,), after their reset; launched separately, like ``draw``."""

    def draw(self, mask: Tensor) -> None:
        """Draw the command of new episodes of ``mask``, bool (E,), in separate launches."""

    def _target(self, *, moving: bool = False) -> Tensor:
        """Declare and return the target [m], (E, 3); for moving targets also ``target_velocity`` [m/s]."""
        if moving:
            self.values.declare(
                "target_velocity", (3,), unit="m/s", frame="world", meaning="velocity of the point to fly to"
            )
        return self.values.declare(TARGET, (3,), unit="m", frame="world", meaning="where to fly")


Generator = TypeVar("Generator", bound=type[Command])


class CommandRegistry(Registry[type[Command]]):
    """Generators by name."""

    def register_class(self, name: str) -> Callable[[Generator], Generator]:
        """Return a decorator that registers a class of commands under ``name``."""

        def add(cls: Generator) -> Generator:
            if not (isinstance(cls, type) and issubclass(cls, Command)):
                raise ConfigError(f"command generator {name!r}: must be a class derived from Command")
            self.register(name, cls)
            cls.name = name
            return cls

        return add


COMMANDS = CommandRegistry("command generator")  # Generators by the name that a task configuration uses
