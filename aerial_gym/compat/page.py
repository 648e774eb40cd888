"""The table of names side by side, made from the tables by which this layer works.

``python -m aerial_gym.compat.page PAGE.md`` writes it between two marks of a page.
"""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from aerial_gym.compat.config import assets, controllers, environments, imus, robots, sensors, sims, tasks
from aerial_gym.compat.config.fields import Table
from aerial_gym.compat.modules import GONE, MODULES
from aerial_gym.compat.names import METHODS
from aerial_gym.compat.tensors import KEYS

BEGIN, END = "<!-- names: begin, by python -m aerial_gym.compat.page -->", "<!-- names: end -->"

TABLES: tuple[tuple[str, Table], ...] = (
    ("Sims", sims.TABLE),
    ("Environments", environments.TABLE),
    ("Obstacles", assets.TABLE),
    ("Robots", robots.TABLE),
    ("Cameras", sensors.CAMERA),
    ("Lidars", sensors.LIDAR),
    ("IMUs", imus.TABLE),
    ("Gains of controllers", controllers.TABLE),
    ("Tasks of this package", tasks.TABLE),
)
"""Every table of configuration classes."""


def names() -> str:
    """Return all names side by side, in Markdown."""
    parts = [
        "### Methods", _methods(),
        "### Tensor keys", _keys(),
        "### Registered names", _registered(),
        "### Module paths", _modules(),
        "### Configuration classes", _classes(),
    ]  # fmt: skip
    return "\n\n".join(parts)


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _code(text: str) -> str:
    return text if text in ("-", "the same") else f"`{text}`"


def _methods() -> str:
    rows = ((f"`{name.theirs.partition(':')[2]}`", _code(name.ours), name.remark) for name in METHODS)
    return _rows(("there", "here", "remark"), rows)


def _keys() -> str:
    rows = ((f"`{name}`", _code(key.ours), key.remark) for name, key in KEYS.items())
    return _rows(("key there", "here", "remark"), rows)


def _registered() -> str:
    return (
        "All sims, environments, robots, controllers and tasks of that simulator are registered here under their names "
        "(`aerial-gym list`), `base_sim_headless` among them."
    )


def _modules() -> str:
    found = (
        (f"`aerial_gym.{path}`", ", ".join(f"`{n}`" for n in given if n) or "-") for path, given in MODULES.items()
    )
    gone = ((f"`aerial_gym.{path}`", way) for path, way in GONE.items())
    return (
        _rows(("module", "names"), found)
        + "\n\nWithout a counterpart; importing one says so:\n\n"
        + _rows(("module", "way out"), gone)
    )


def _classes() -> str:
    parts = []
    for title, table in TABLES:
        rows = [
            (f"`{f.theirs}`", _code(f.ours), f"other values are refused: {f.remark}" if f.refused else f.remark)
            for f in table.fields
        ]
        rows += [(f"`{section}.*`", "-", why) for section, why in table.idle_sections.items()]
        parts += [f"**{title}**", _rows(("attribute", "here", "remark"), rows)]
    return "\n\n".join(parts)


def with_names(text: str) -> str:
    """Return a page with the table between its two marks written anew."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n\n{names()}\n\n{END}{rest.partition(END)[2]}"


if __name__ == "__main__":
    page = Path(sys.argv[1])
    page.write_text(with_names(page.read_text(encoding="utf-8")), encoding="utf-8")
