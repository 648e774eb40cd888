"""The pages of configuration keys: unit, default, range and meaning of every field of every configuration dataclass."""

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages

import aerial_gym
from docs.generate.markdown import DocumentedField, code_marks, documented_fields, page, table, type_text, value_text

PAGES: Mapping[str, tuple[str, Sequence[str]]] = {
    "robot": ("Keys of a robot file", ("robot", "rotor", "joint", "sensor_mount", "learned_residual")),
    "control": ("Keys of controllers", ("controller", "autopilots")),
    "environment": ("Keys of an environment file", ("environment", "vehicles", "shape")),
    "sensor": ("Keys of a sensor file", ("range_sensor", "sensor", "lidar", "images")),
    "task": ("Keys of a task file", ("task", "task_terms", "randomize", "sim")),
    "training": (
        "Keys of training settings",
        (
            "aerial_gym.rl_training.settings",
            "aerial_gym.rl_training.learner_settings",
            "aerial_gym.rl_training.policies.body",
            "aerial_gym.rl_training.encoder.settings",
        ),
    ),
}
"""Title and modules of each page; names without a dot are modules of ``aerial_gym.config``."""

PACKAGE = Path(aerial_gym.__file__).parent

INTRODUCTION = (
    "For authors of configuration files. Each section is one mapping of the file. Unknown keys are refused, and values "
    "outside the stated range too."
)


def configuration_pages() -> dict[str, str]:
    """Return the pages by their path below ``reference/``."""
    return {
        f"configuration/{name}.md": page(title, INTRODUCTION, map(_section, _classes(modules)))
        for name, (title, modules) in PAGES.items()
    }


def documented_names() -> set[str]:
    """Return the names of the dataclasses that have a section on one of the pages."""
    return {cls.__name__ for _, modules in PAGES.values() for cls in _classes(modules)}


def configuration_names() -> set[str]:
    """Return the names of all configuration classes in the source of the package."""
    files = (path for folder in ("config", "rl_training") for path in (PACKAGE / folder).rglob("*.py"))
    return {name for path in files for name in re.findall(r"^class (\w+Cfg)\b", path.read_text("utf-8"), re.MULTILINE)}


def _classes(modules: Sequence[str]) -> Iterator[type]:
    for name in modules:
        path = name if "." in name else f"aerial_gym.config.{name}"
        yield from _defined(path)
        for child in walk_packages(getattr(import_module(path), "__path__", ()), f"{path}."):
            yield from _defined(child.name)


def _defined(path: str) -> Iterator[type]:
    """Yield the public configuration dataclasses that a module defines, in the order of its source."""
    for name, cls in vars(import_module(path)).items():
        if inspect.isclass(cls) and is_dataclass(cls) and cls.__module__ == path and name.endswith("Cfg"):
            yield cls


def _section(cls: type) -> str:
    rows = map(_row, documented_fields(cls))
    head = ("key", "type", "unit", "default", "meaning and range")
    return "\n\n".join([f"## {cls.__name__}", code_marks(inspect.getdoc(cls) or ""), table(head, rows)])


def _row(field: DocumentedField) -> tuple[str, str, str, str, str]:
    unit = re.search(r"\[([^\]`']+)\]", field.text)
    return (
        f"`{field.name}`",
        type_text(field.hint),
        unit[1] if unit else "-",
        value_text(field.default),
        field.text,
    )
