"""``aerial-gym list``: registered names."""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass
from shutil import get_terminal_size
from textwrap import fill

from aerial_gym.config.console import json_line
from aerial_gym.errors import UnknownNameError
from aerial_gym.lazy import Home

KINDS = {
    "sims": (Home("aerial_gym.env_manager:SIMS"),),
    "environments": (Home("aerial_gym.assets:ENVIRONMENTS"),),
    "robots": (Home("aerial_gym.robots:ROBOTS"),),
    "controllers": (Home("aerial_gym.control:CONTROLLERS"),),
    "sensors": (Home("aerial_gym.sensors:SENSORS"), Home("aerial_gym.sensors:IMUS")),
    "imus": (Home("aerial_gym.sensors:IMUS"),),
    "effects": (Home("aerial_gym.physics:EFFECTS"),),
    "backends": (Home("aerial_gym.physics:BACKENDS"),),
    "tasks": (Home("aerial_gym.task:task_registry"),),
    "trainers": (Home("aerial_gym.rl_training:TRAINERS"),),
}
"""Registries by kind. None of them imports torch or Warp for its names."""

UNREGISTERED = {"effects": {"learned_residual": Home("aerial_gym.physics.effects.learned_residual:LearnedResidual")}}
"""Entries that are no names to build from: a learned residual has the numbers of its robot file."""

PARTS_OF_TASKS = {
    "observation-terms": (Home("aerial_gym.task:OBSERVATIONS"),),
    "reward-terms": (Home("aerial_gym.task:REWARDS"),),
    "termination-terms": (Home("aerial_gym.task:TERMINATIONS"),),
    "task-buffers": (Home("aerial_gym.task:BUFFERS"),),
    "commands": (Home("aerial_gym.task:COMMANDS"),),
    "actions": (Home("aerial_gym.task:ACTIONS"),),
}
"""Parts of tasks, listed only on request, as their functions import torch."""


@dataclass(frozen=True, kw_only=True)
class ListCmd:
    """List what is registered, with one line each."""

    kind: str | None = None
    """sims, environments, robots, controllers, sensors, imus, effects, backends, tasks or trainers; all of these if not given.
    Or parts of tasks: observation-terms, reward-terms, termination-terms, task-buffers, commands, actions."""

    json: bool = False
    """Print one JSON object instead of a table."""

    @classmethod
    def parse(cls, argv: Sequence[str]) -> "ListCmd":
        """Return the command of its arguments. Without tyro, whose import alone takes as long as everything here."""
        parser = ArgumentParser(prog="aerial-gym list", description=cls.__doc__, allow_abbrev=False)
        parser.add_argument(
            "kind", nargs="?", help=f"one of {', '.join(KINDS)}, all if not given; or {', '.join(PARTS_OF_TASKS)}"
        )
        parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
        return cls(**vars(parser.parse_args(argv)))

    def run(self) -> int:
        """Print names and summaries by kind."""
        kinds = KINDS if self.kind is None else KINDS | PARTS_OF_TASKS
        if self.kind is not None and self.kind not in kinds:
            raise UnknownNameError(f"no kind {self.kind!r}. Known: {', '.join(kinds)}")
        found = {kind: _summaries(kind, homes) for kind, homes in kinds.items() if self.kind in (None, kind)}
        if self.json:
            print(json_line(found, indent=2))
            return 0
        rows = [(kind, name, line) for kind, lines in found.items() for name, line in lines.items()]
        widths = [max(len(row[column]) for row in rows) + 2 for column in (0, 1)]
        for kind, name, line in rows:
            print(_wrapped(f"{kind:<{widths[0]}}{name:<{widths[1]}}", line))
        return 0


def _summaries(kind: str, homes: Sequence[Home]) -> dict[str, str]:
    """Return the names and lines of a kind, registry by registry, without the marks of code in docstrings."""
    found = {name: line for home in homes for name, line in home.load().summaries().items()}
    more = {name: home.summary() for name, home in UNREGISTERED.get(kind, {}).items()}
    both = dict(sorted((found | more).items())) if more else found
    return {name: line.replace("``", "") for name, line in both.items()}


def _wrapped(head: str, line: str) -> str:
    """Return a row of the table; broken between words where a terminal would break it anywhere."""
    if not sys.stdout.isatty():
        return head + line
    width = max(get_terminal_size().columns, len(head) + 20)
    return fill(line, width, initial_indent=head, subsequent_indent=" " * len(head))
