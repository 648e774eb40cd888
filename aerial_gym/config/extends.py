"""Configuration files that build on another: ``extends:`` and the fields that differ.

A base is a file of the package by name, or a path (``.yaml``) relative to the file that names it, and may extend another
one. Mappings are merged into the base, null removes an entry, and other values replace those of the base. For lists of
named entries, such as joints, a mapping gives the changes by name.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from aerial_gym.config.loader import build, family_files, format_value, read_yaml, to_mapping
from aerial_gym.config.sensor_mount import is_file
from aerial_gym.errors import ConfigError, suggest_name

T = TypeVar("T")


def load_extended(
    cls: type[T], path: str | Path, *, family: str, located: Callable[[T, Path], T] = lambda cfg, _: cfg
) -> T:
    """Return the dataclass ``cls`` filled from a YAML file and those that it builds on.

    Args:
        family: Folder of the package in which, and in whose rooms, names are looked up.
        located: Returns a configuration whose paths, relative to a folder, are found from anywhere.
    """
    return _load_file(cls, Path(path), family, located, ())


def _load_file(cls: type[T], path: Path, family: str, located: Callable[[T, Path], T], above: tuple[Path, ...]) -> T:
    data, resolved = read_yaml(path), path.resolve()
    if resolved in above:
        names = " -> ".join(file.name for file in (*above[above.index(resolved) :], resolved))
        raise ConfigError(f"{path}: extends itself ({names})")
    if "extends" in data:
        base = _load_file(cls, _base_file(path, data.pop("extends"), family), family, located, (*above, resolved))
        data = _overlay(to_mapping(base), data, str(path))
    return located(build(cls, data, where=str(path)), resolved.parent)


def _base_file(path: Path, name: object, family: str) -> Path:
    if not isinstance(name, str):
        raise ConfigError(f"{path}: extends = {format_value(name)}: must be one name, or the path of a .yaml file")
    if is_file(name):
        return path.resolve().parent / name
    known = family_files(family)
    if name in known:
        return known[name]
    hint = suggest_name(name, known)
    raise ConfigError(
        f"{path}: extends = {format_value(name)}: no such file in the package.{hint} Known: {', '.join(known)}; "
        "give a file of your own by its path, which ends in .yaml"
    )


def _overlay(base: Mapping[str, object], change: Mapping[str, object], where: str) -> dict[str, object]:
    """Return a mapping with a change on top; neither is touched."""
    merged = {**base}
    for key, value in change.items():
        if value is None:
            merged.pop(key, None)
        else:
            merged[key] = _merge_value(base.get(key), value, f"{where}: {key}")
    return merged


def _merge_value(base: object, value: object, where: str) -> object:
    if not isinstance(value, Mapping):
        return value
    if isinstance(base, Mapping):
        return _overlay(base, value, where)
    return _merge_entries(base, value, where) if isinstance(base, list) else value


def _merge_entries(base: list[object], value: Mapping[str, object], where: str) -> list[object]:
    """Return a list of named entries with the changes of a mapping by name."""
    entries = {str(entry.get("name")): entry for entry in base if isinstance(entry, Mapping) and entry.get("name")}
    if len(entries) < len(base) or not base:
        raise ConfigError(f"{where}: entries of this list have no names in the base. Give the whole list")
    if unknown := [name for name in value if name not in entries]:
        raise ConfigError(f"{where}: the base has no {format_value(unknown[0])} here. Names: {', '.join(entries)}")
    return list(_overlay(entries, value, where).values())
