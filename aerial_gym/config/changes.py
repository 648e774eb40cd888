"""Changes of single settings by dotted keys, such as ``robot.body.mass=0.3``, as ``--set`` takes them."""

from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from aerial_gym.config.loader import build, convert, format_value, to_mapping
from aerial_gym.errors import ConfigError, suggest_name

T = TypeVar("T")

MOST_NAMES = 10  # Most known names in a message
SIMULATION = ("task", "robot", "env", "sim", "controller")  # Configurations of a simulation, each first part of a key


def changes_simulation(text: str) -> bool:
    """Return whether a setting ``KEY=VALUE`` belongs to a configuration of the simulation."""
    root, dot, _ = text.partition("=")[0].partition(".")
    return bool(dot) and root in SIMULATION


def settings_of_run(settings: Iterable[str], *, robot: object, task: object) -> tuple[str, ...]:
    """Return the settings of a run that still apply where another robot or task, if not None, takes the place of its own."""
    left_out = {
        *(("robot",) if robot is not None else ()),
        *(("task", "env", "sim", "controller") if task is not None else ()),
    }
    return tuple(each for each in settings if each.partition(".")[0] not in left_out)


class Changes:
    """Settings ``KEY=VALUE``; ``apply`` changes one configuration, and ``finish`` reports all wrong settings together."""

    def __init__(self, settings: Iterable[str] = ()) -> None:
        """Take the texts. A value is YAML: a number, a text, ``true``, ``null``, ``[1, 2]`` or ``{name: 1}``."""
        self._texts: dict[str, str] = {}
        self._errors: list[str] = []
        for setting in settings:
            key, sign, text = setting.partition("=")
            if sign and key.strip():
                self._texts[key.strip()] = text.strip()
            else:
                self._errors.append(f"{setting!r}: must be KEY=VALUE, such as robot.body.mass=0.3")
        self._roots: list[str] = []

    def refuse(self, key: str, reason: str) -> None:
        """Make a setting wrong, if it is given."""
        if key in self._texts:
            self._errors.append(f"{key}: {reason}")

    def apply(self, root: str, config: T) -> T:
        """Return a configuration with the settings of a root; those without one belong to the root ``""``.

        With a wrong setting, the configuration is returned unchanged, and ``finish`` raises the error.
        """
        self._roots.append(root)
        own = [key for key in self._texts if (key.startswith(f"{root}.") if root else not changes_simulation(key))]
        merged, known = to_mapping(config) if own else {}, len(self._errors)
        for key in own:
            parts = key.removeprefix(f"{root}." if root else "").split(".")
            try:
                merged = _replace_value(type(config), merged, parts, self._texts[key], root)
            except ConfigError as error:
                self._errors.append(str(error))
        if not own or len(self._errors) > known:
            return config
        try:
            return build(type(config), merged, where=f"--set {', '.join(own)}")
        except ConfigError as error:
            self._errors.append(str(error))
            return config

    def finish(self) -> None:
        """Raise ``ConfigError`` with all wrong settings; one whose root was not applied is wrong."""
        for key in self._texts if "" not in self._roots else ():
            first = key.partition(".")[0]
            if "." not in key or first not in self._roots:
                self._errors.append(_unknown(key, first, self._roots))
        if self._errors:
            raise ConfigError(*self._errors)


def _unknown(key: str, name: str, known: Collection[str]) -> str:
    """Return the message for an unknown part of a key: the similar name, or the first known ones."""
    names = [*known][:MOST_NAMES] + ["..."] * (len(known) > MOST_NAMES)
    hint = suggest_name(name, known) or f" Known: {', '.join(names) or 'none'}"
    return f"{key}: no setting {name!r} here.{hint}"


def _replace_value(hint: Any, value: Any, parts: list[str], text: str, where: str) -> Any:
    """Return a plain value of a type with one part replaced; the value itself is not touched.

    Args:
        hint: Type of the value.
        parts: Remaining parts of the key.
        text: New value.
        where: Key up to here.
    """
    if not parts:
        return _parse_value(hint, text, where)
    name, *rest = parts
    key, kinds = f"{where}.{name}".lstrip("."), get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
    structure = next((kind for kind in kinds if is_dataclass(kind)), None)
    entries = next((kind for kind in kinds if get_origin(kind) in (tuple, Mapping)), None)
    if structure is not None and (value is None or isinstance(value, Mapping)):
        known = [field.name for field in fields(structure)]
        if name not in known:
            raise ConfigError(_unknown(key, name, dict.fromkeys((*known, *(() if where else SIMULATION)))))
        present = value or {}
        return {**present, name: _replace_value(get_type_hints(structure)[name], present.get(name), rest, text, key)}
    if isinstance(value, list) and entries is not None:
        return _replace_in_list(get_args(entries)[0], value, parts, text, where)
    if isinstance(value, Mapping) and entries is not None:
        return _replace_in_mapping(get_args(entries)[1], value, parts, text, where)
    raise ConfigError(f"{where}: is {format_value(value)}, which has no part {name!r}. Set {where} itself")


def _replace_in_list(hint: Any, value: list[Any], parts: list[str], text: str, where: str) -> list[Any]:
    """Return a list with one entry changed, chosen by its name or by its number from 0 on."""
    name, *rest = parts
    names = [str(entry.get("name", n)) if isinstance(entry, Mapping) else str(n) for n, entry in enumerate(value)]
    if name not in names:
        raise ConfigError(_unknown(f"{where}.{name}", name, names))
    place = names.index(name)
    changed = _replace_value(hint, value[place], rest, text, f"{where}.{name}")
    return [*value[:place], changed, *value[place + 1 :]]


def _replace_in_mapping(hint: Any, value: Mapping[str, Any], parts: list[str], text: str, where: str) -> dict[str, Any]:
    """Return a mapping with one entry changed, added, or removed by ``null``; a name may contain dots."""
    lengths = [n for n in range(len(parts), 0, -1) if ".".join(parts[:n]) in value]
    size = lengths[0] if lengths else 1
    name, rest = ".".join(parts[:size]), parts[size:]
    if name not in value and rest and is_dataclass(hint):
        raise ConfigError(_unknown(f"{where}.{name}", name, value))
    if not rest and text == "null":
        return {key: entry for key, entry in value.items() if key != name}
    return {**value, name: _replace_value(hint, value.get(name, {}), rest, text, f"{where}.{name}")}


def _parse_value(hint: Any, text: str, where: str) -> Any:
    """Return the plain value of a text, which must be of a type; a text field takes it as it is."""
    try:
        value = yaml.safe_load(text)
    except yaml.YAMLError:
        value = text
    try:
        convert(hint, value, where)
    except ConfigError:
        with suppress(ConfigError):
            convert(hint, text, where)
            return text
        raise
    return value
