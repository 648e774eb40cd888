"""``aerial-gym list``: what is registered."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from aerial_gym.errors import UnknownNameError


def _entries() -> dict[str, Callable[[], dict[str, str]]]:
    """Return, per kind, what makes the names and one line each."""
    from aerial_gym.assets import ENVIRONMENTS
    from aerial_gym.control import CONTROLLERS
    from aerial_gym.env_manager import SIMS
    from aerial_gym.physics import BACKENDS, EFFECTS
    from aerial_gym.registry import Registry
    from aerial_gym.robots import ROBOTS
    from aerial_gym.sensors import SENSORS
    from aerial_gym.task import task_registry

    def summaries(registry: Registry) -> Callable[[], dict[str, str]]:
        return lambda: {name: registry.get(name).summary for name in registry.names()}

    return {
        "sims": summaries(SIMS),
        "environments": summaries(ENVIRONMENTS),
        "robots": summaries(ROBOTS),
        "controllers": summaries(CONTROLLERS),
        "sensors": summaries(SENSORS),
        "effects": summaries(EFFECTS),
        "backends": lambda: {name: (BACKENDS.get(name).__doc__ or "").splitlines()[0] for name in BACKENDS.names()},
        "tasks": summaries(task_registry),
    }


@dataclass(frozen=True, kw_only=True)
class ListCmd:
    """List what is registered, with one line each."""

    kind: Annotated[str | None, tyro.conf.Positional] = None
    """sims, environments, robots, controllers, sensors, effects, backends or tasks; everything if not given."""

    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> int:
        """Print names and summaries by kind."""
        entries = _entries()
        if self.kind is not None and self.kind not in entries:
            raise UnknownNameError(f"no kind {self.kind!r}. Known: {', '.join(entries)}")
        found = {kind: make() for kind, make in entries.items() if self.kind in (None, kind)}
        if self.json:
            print(json.dumps(found, ensure_ascii=False, indent=2))
            return 0
        table = Table(box=None, pad_edge=False)
        for head in ("kind", "name", "summary"):
            table.add_column(head, overflow="fold")
        for kind, names in found.items():
            for name, summary in names.items():
                table.add_row(kind, name, summary)
        Console(markup=False).print(table)
        return 0
