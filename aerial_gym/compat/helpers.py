"""Helpers of scripts: the folder of the package, a logger, and the flags that Isaac Gym's ``gymutil`` parses there."""

import argparse
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from aerial_gym.interop import resolve_device

AERIAL_GYM_DIRECTORY = str(Path(__file__).resolve().parents[2])
"""Folder that holds ``aerial_gym/``, as scripts build paths from it. That simulator's ``resources/`` are not there: robots and
obstacles are YAML files in ``aerial_gym/config/``."""


class CustomLogger(logging.LoggerAdapter):
    """A logger by name; ``print_example_message`` greets from an example."""

    def __init__(self, logger_name: str) -> None:
        super().__init__(logging.getLogger(logger_name), {})

    def setLoggerLevel(self, level: int | str) -> None:  # noqa: N802 (their name)
        """Set the lowest level that is shown."""
        self.logger.setLevel(level)

    def print_example_message(self) -> None:
        """Say that an example begins."""
        self.info("An example in the manner of the Aerial Gym Simulator; see docs/guides/coming_from_aerial_gym.md")


def parse_arguments(
    description: str = "Aerial Gym Example", headless: bool = False, no_graphics: bool = False,
    custom_parameters: Sequence[Mapping[str, Any]] = (), argv: Sequence[str] | None = None,
) -> argparse.Namespace:  # fmt: skip
    """Return the flags of a script.

    Args:
        headless: Whether there is a flag ``--headless``; accepted without effect, as there is no viewer window.
        no_graphics: The same for ``--nographics``.
        custom_parameters: The script's own flags: ``name`` and further arguments for ``argparse``.
        argv: The command line; that of the process if not given.

    Returns:
        The flags, and ``sim_device``, ``sim_device_type``, ``compute_device_id`` and ``rl_device`` as there.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--sim_device", default=str(resolve_device("auto")), help="torch device of the simulation")
    parser.add_argument("--rl_device", help="torch device of the policy; that of the simulation if not given")
    own = {parameter["name"] for parameter in custom_parameters}
    for name, wanted in (("--headless", headless), ("--nographics", no_graphics)):
        if wanted and name not in own:
            parser.add_argument(name, action="store_true", help="without effect: there is no viewer window")
    for parameter in custom_parameters:
        parser.add_argument(parameter["name"], **{key: value for key, value in parameter.items() if key != "name"})
    args = parser.parse_args(argv)
    kind, _, number = args.sim_device.partition(":")
    args.sim_device_type, args.compute_device_id = kind, int(number or 0)
    args.rl_device = args.rl_device or args.sim_device
    return args


def get_args(additional_parameters: Sequence[Mapping[str, Any]] = ()) -> argparse.Namespace:
    """Return the flags of that simulator's examples: ``--num_envs``, ``--headless``, ``--use_warp`` and more."""
    flags = (
        {"name": "--num_envs", "type": int, "default": 64, "help": "environments side by side"},
        {"name": "--headless", "type": _boolean, "default": True, "help": "without effect: there is no viewer window"},
        {"name": "--use_warp", "type": _boolean, "default": True, "help": "without effect: sensors always are Warp's"},
        {"name": "--task", "type": str, "default": "navigation_task", "help": "registered task"},
    )
    own = {parameter["name"] for parameter in additional_parameters}
    defaults = (flag for flag in flags if flag["name"] not in own)
    return parse_arguments(custom_parameters=[*defaults, *additional_parameters])


def _boolean(text: str) -> bool:
    return text.lower() in ("1", "true", "yes", "y", "on", "t")
