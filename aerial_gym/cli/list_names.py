"""``aerial-gym list``: registered names."""

import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from dataclasses import dataclass
from shutil import get_terminal_size
from textwrap import fill

from aerial_gym.config.console import json_line
from aerial_gym.errors import UnknownNameError
from aerial_gym.lazy import ImportPath

KINDS = {
    "sims": (ImportPath("aerial_gym.env_manager:SIMS"),),
    "environments": (ImportPath("aerial_gym.assets:ENVIRONMENTS"),),
    "robots": (ImportPath("aerial_gym.robots:ROBOTS"),),
    "controllers": (ImportPath("aerial_gym.control:CONTROLLERS"),),
    "sensors": (ImportPath("aerial_gym.sensors:SENSORS"), ImportPath("aerial_gym.sensors:IMUS")),
    "imus": (ImportPath("aerial_gym.sensors:IMUS"),),
    "control-laws": (ImportPath("aerial_gym.control:CONTROL_LAWS"),),
    "effects": (ImportPath("aerial_gym.physics:EFFECTS"),),
    "rotor-maps": (ImportPath("aerial_gym.physics:ROTOR_MAPS"),),
    "backends": (ImportPath("aerial_gym.physics:BACKENDS"),),
    "tasks": (ImportPath("aerial_gym.task:task_registry"),),
    "log-formats": (ImportPath("aerial_gym.registry.log_formats:LOG_READERS"),),
    "pretrained": (ImportPath("aerial_gym.rl_training.policies.catalog:PRETRAINED"),),
    "trainers": (ImportPath("aerial_gym.rl_training:TRAINERS"),),
}  # fmt: skip
"""Registries by kind. None of them imports torch or Warp for its names."""

LEE = ("position", "pose", "steering", "velocity", "acceleration", "attitude", "rates")

UNREGISTERED = {
    "effects": {"learned_residual": ImportPath("aerial_gym.physics.effects.learned_residual:LearnedResidual")},
    "control-laws": {law: ImportPath(f"aerial_gym.control.lee:{law}_control") for law in LEE}
    | {"thrust": ImportPath("aerial_gym.control.controllers:ThrustController"),
       "rotor_speed": ImportPath("aerial_gym.control.controllers:RotorSpeedController")},
}  # fmt: skip
"""Names outside a registry: a learned residual has the numbers of its robot file; laws of this package are in ``LAWS``."""

ON_REQUEST = {
    "observation-terms": (ImportPath("aerial_gym.task:OBSERVATIONS"),),
    "reward-terms": (ImportPath("aerial_gym.task:REWARDS"),),
    "termination-terms": (ImportPath("aerial_gym.task:TERMINATIONS"),),
    "task-buffers": (ImportPath("aerial_gym.task:BUFFERS"),),
    "commands": (ImportPath("aerial_gym.task:COMMANDS"),),
    "actions": (ImportPath("aerial_gym.task:ACTIONS"),),
    "shapes": (ImportPath("aerial_gym.assets:FAMILIES"),),
}
"""Parts of tasks and shapes, listed only on request, as their functions import torch or NumPy."""


@dataclass(frozen=True, kw_only=True)
class ListCmd:
    """List what is registered, with one line each."""

    kind: str | None = None
    """sims, environments, robots, controllers, control-laws, sensors, imus, effects, rotor-maps, backends, tasks, trainers,
    pretrained (policies) or log-formats; all of these if not given. Or observation-terms, reward-terms, termination-terms,
    task-buffers, commands, actions, shapes."""

    json: bool = False  # Print one JSON object instead of a table

    @classmethod
    def parse(cls, argv: Sequence[str]) -> "ListCmd":
        """Return the command of its arguments. Without tyro, whose import alone takes as long as everything here."""
        parser = ArgumentParser(prog="aerial-gym list", description=cls.__doc__, allow_abbrev=False)
        parser.add_argument(
            "kind", nargs="?", help=f"one of {', '.join(KINDS)}, all if not given; or {', '.join(ON_REQUEST)}"
        )
        parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
        return cls(**vars(parser.parse_args(argv)))

    def run(self) -> int:
        """Print names and summaries by kind, with the packages of plug-ins."""
        kinds = KINDS if self.kind is None else KINDS | ON_REQUEST
        if self.kind is not None and self.kind not in kinds:
            raise UnknownNameError(f"no kind {self.kind!r}. Known: {', '.join(kinds)}")
        chosen = kinds if self.kind is None else {self.kind: kinds[self.kind]}
        summaries = {kind: _name_summaries(kind, homes) for kind, homes in chosen.items()}
        packages = {
            kind: {name: package for home in homes for name, package in home.load().packages().items()}
            for kind, homes in chosen.items()
        }
        if self.json:
            plugins = {kind: names for kind, names in packages.items() if names}
            print(json_line(summaries | ({"packages": plugins} if plugins else {}), indent=2))
            return 0
        rows = [
            (kind, name, f"{line} (package {packages[kind][name]})".lstrip() if name in packages[kind] else line)
            for kind, lines in summaries.items()
            for name, line in lines.items()
        ]
        widths = [max(len(row[column]) for row in rows) + 2 for column in (0, 1)]
        for kind, name, line in rows:
            print(_wrap_row(f"{kind:<{widths[0]}}{name:<{widths[1]}}", line))
        return 0


def _name_summaries(kind: str, homes: Sequence[ImportPath]) -> dict[str, str]:
    """Return the names and lines of a kind, registry by registry, without the marks of code in docstrings."""
    summaries = {name: line for home in homes for name, line in home.load().summaries().items()}
    more = {name: home.summary() for name, home in UNREGISTERED.get(kind, {}).items()}
    both = dict(sorted((summaries | more).items())) if more else summaries
    return {name: line.replace("``", "") for name, line in both.items()}


def _wrap_row(head: str, line: str) -> str:
    """Return a row of the table; broken between words where a terminal would break it anywhere."""
    if not sys.stdout.isatty():
        return head + line
    width = max(get_terminal_size().columns, len(head) + 20)
    return fill(line, width, initial_indent=head, subsequent_indent=" " * len(head))
