"""Commands as Python functions: their arguments are the options of the command line, and they return the result.

Progress is that of the command. Neither torch nor Warp is imported before a call.
"""

from collections.abc import Callable
from inspect import getdoc, signature
from typing import ParamSpec, Protocol, TypeVar, cast, get_origin, get_type_hints

from aerial_gym.cli.close_loop import CloseLoopCmd
from aerial_gym.cli.evaluate import EvaluateCmd
from aerial_gym.cli.play import PlayCmd
from aerial_gym.cli.robot import CheckRobotCmd
from aerial_gym.cli.robustness import RobustnessCmd
from aerial_gym.cli.train import TrainCmd
from aerial_gym.config.loader import build
from aerial_gym.errors import ConfigError

Options = ParamSpec("Options")
Result = TypeVar("Result", covariant=True)


class ResultCommand(Protocol[Result]):
    """A command that returns its result without printing it."""

    def result(self) -> Result:
        """Do the work and return its result."""
        ...


def command_function(command: Callable[Options, ResultCommand[Result]], name: str) -> Callable[Options, Result]:
    """Return the function of a command's dataclass; a list option takes a single entry, a path option also a string."""
    cls = cast("type[ResultCommand[Result]]", command)
    whole = signature(cls)
    lists = {key for key, hint in get_type_hints(cls).items() if get_origin(hint) is tuple}

    def run(*args: Options.args, **options: Options.kwargs) -> Result:
        if "json" in options:
            raise ConfigError(
                f"{name}: json belongs to the command line. The function returns the result: leave it out"
            )
        given = {**run.__signature__.bind_partial(*args).arguments, **options}  # type: ignore[attr-defined]
        single = {key: (value,) for key, value in given.items() if key in lists and not isinstance(value, list | tuple)}
        return build(cls, given | single, where=name).result()

    shown = [each for each in whole.parameters.values() if each.name != "json"]
    run.__signature__ = whole.replace(parameters=shown, return_annotation=cls.result.__annotations__["return"])  # type: ignore[attr-defined]
    run.__name__ = run.__qualname__ = name
    run.__doc__ = f"{getdoc(cls)}\n\nArguments are the options of the command of this name, which its --help describes."
    return run


train = command_function(TrainCmd, "train")  # Train a policy
evaluate = command_function(EvaluateCmd, "evaluate")  # Return the figures of a policy
play = command_function(PlayCmd, "play")  # Return flights of a policy
robustness = command_function(RobustnessCmd, "robustness")  # Return the success of a policy in named conditions
close_loop = command_function(CloseLoopCmd, "close_loop")  # Return the verdict on a declared robot
check = command_function(CheckRobotCmd, "check")  # Return the report of each robot
