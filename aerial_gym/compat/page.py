"""Names of the Aerial Gym Simulator beside ours, from the tables by which this layer works; the site shows them."""

from collections.abc import Iterable, Sequence

from aerial_gym.compat.config import assets, controllers, environments, imus, robots, sensors, sims, tasks
from aerial_gym.compat.config.fields import ConfigTable
from aerial_gym.compat.modules import GONE, MODULES
from aerial_gym.compat.names import METHODS
from aerial_gym.compat.tensors import KEYS

TABLES: tuple[tuple[str, ConfigTable], ...] = (
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
        "## Methods", _methods(),
        "## Tensor keys", _keys(),
        "## Registered names", _registry_note(),
        "## Module paths", _modules(),
        "## Configuration classes", _classes(),
    ]  # fmt: skip
    return "\n\n".join(parts)


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


def _code(text: str) -> str:
    return text if text in ("-", "the same") else f"`{text}`"


def _methods() -> str:
    rows = ((f"`{name.script_name.partition(':')[2]}`", _code(name.native), name.remark) for name in METHODS)
    return _rows(("there", "here", "remark"), rows)


def _keys() -> str:
    rows = ((f"`{name}`", _code(key.native), key.remark) for name, key in KEYS.items())
    return _rows(("key there", "here", "remark"), rows)


def _registry_note() -> str:
    return (
        "All sims, environments, robots, controllers and tasks of that simulator are registered here under their names "
        "(`aerial-gym list`), `base_sim_headless` among them."
    )


def _modules() -> str:
    module_rows = (
        (f"`aerial_gym.{path}`", ", ".join(f"`{n}`" for n in given if n) or "-") for path, given in MODULES.items()
    )
    gone = ((f"`aerial_gym.{path}`", way) for path, way in GONE.items())
    return (
        _rows(("module", "names"), module_rows)
        + "\n\nWithout a counterpart; importing one says so:\n\n"
        + _rows(("module", "way out"), gone)
    )


def _classes() -> str:
    parts = []
    for title, table in TABLES:
        rows = [
            (f"`{f.script_name}`", _code(f.native), f"other values are refused: {f.remark}" if f.refused else f.remark)
            for f in table.fields
        ]
        rows += [(f"`{section}.*`", "-", why) for section, why in table.idle_sections.items()]
        parts += [f"**{title}**", _rows(("attribute", "here", "remark"), rows)]
    return "\n\n".join(parts)
