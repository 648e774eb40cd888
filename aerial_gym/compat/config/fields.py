"""Translation of Aerial Gym Simulator configuration classes to the frozen configurations of this package.

In that simulator a configuration is a class with attributes, in nested classes, that users derive and change. Here a table
has a ``Field`` with the translation of each attribute. It generates classes from the configurations of this package and
translates them back, so that each number is in one YAML file. Attributes that a class does not set keep the value of its
nearest generated ancestor. Other attributes are the class's own helpers; one whose name is nearly that of a field is refused.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from inspect import isclass
from operator import attrgetter
from typing import Any

import numpy as np

from aerial_gym.errors import ConfigError

STANDS_FOR = "_aerial_gym"  # Attribute of a generated class that holds its frozen configuration
Values = Mapping[str, Any]  # Values by dotted path, such as `env.num_envs`, and the configuration under `STANDS_FOR`
Changes = dict[str, Any]  # New values of fields of our configuration by dotted path, such as `rotor.torque_ratio`

MISSPELLED = 0.85  # Similarity of names from which an unknown attribute is a misspelled field; one letter in ten is 0.9

_logger = logging.getLogger(__name__)
_logged: set[str] = set()


def log_once(text: str, level: int = logging.INFO) -> None:
    """Log a text, at its first call in a process only."""
    if text not in _logged:
        _logged.add(text)
        _logger.log(level, text)


@dataclass(frozen=True, kw_only=True)
class ConfigField:
    """One attribute of a configuration class and its translation."""

    script_name: str  # Dotted path in the class
    native: str  # Counterpart in this package, for the documentation; ``-`` for none
    remark: str = ""  # Difference, or reason for the missing counterpart
    read: Callable[[Any], object]  # Value in a class generated from a configuration
    write: Callable[[Values], Changes] | None = None  # Changes of the configuration from all values; None without any
    refused: bool = False  # Whether another value is an error, with ``remark`` as the remedy; otherwise it is logged


def native_field(
    script_name: str, native: str, read: Callable[[Any], object], write: Callable[[Values], Changes] | None = None,
    remark: str = "",
) -> ConfigField:  # fmt: skip
    """Return a field with the same meaning in both; ``write`` converts the value if it differs."""
    write = write or (lambda v: {native: v[script_name]})
    return ConfigField(script_name=script_name, native=native, remark=remark, read=read, write=write)


def same_fields(*names: str, **native_by_name: str) -> tuple[ConfigField, ...]:
    """Return fields with the same meaning and value in both, some under another name in this package."""
    pairs = dict(zip(names, names, strict=True)) | native_by_name
    return tuple(native_field(name, native, attrgetter(native)) for name, native in pairs.items())


def idle_field(script_name: str, value: object, remark: str) -> ConfigField:
    """Return a field without meaning in this package, which takes any value."""
    return ConfigField(script_name=script_name, native="-", remark=remark, read=lambda _: value)


def unchangeable_field(script_name: str, value: object, remark: str) -> ConfigField:
    """Return a field with one allowed value, or that of a function of the configuration; ``remark`` is the remedy."""
    read = value if callable(value) else lambda _: value
    return ConfigField(script_name=script_name, native="-", remark=remark, read=read, refused=True)


def class_only_field(script_name: str, native: str, read: Callable[[Any], object], remark: str = "") -> ConfigField:
    """Return a field that code reads from the class on demand, without a target in the configuration."""
    return ConfigField(script_name=script_name, native=native, remark=remark, read=read, write=lambda _: {})


@dataclass(frozen=True, kw_only=True)
class ConfigTable:
    """All attributes of one family of configuration classes."""

    kind: str  # Kind of the classes in messages
    fields: tuple[ConfigField, ...]  # Attributes that are known
    idle_sections: Mapping[str, str] = field(default_factory=dict)  # Nested classes without any meaning here, and why

    def make_class(self, name: str, cfg: object, *, parent: type | None = None) -> type:
        """Return the class generated from a configuration; with a ``parent`` of the same table it has only the differences."""
        base = parent or type(name, (), {})
        made = type(name, (base,), {STANDS_FOR: cfg, "__doc__": f"Class-style configuration of a {self.kind}."})
        for each in self.fields:
            value = each.read(cfg)
            if parent is None or not values_equal(value, attrgetter(each.script_name)(parent)):
                _set_attribute(made, each.script_name, value)
        for section in self.idle_sections if parent is None else ():
            _set_attribute(made, section, type(section.rpartition(".")[2], (), {}))
        return made

    def values(self, cls: Any) -> dict[str, Any]:
        """Return all values of a configuration class, or of an object of one, that a table knows.

        Raises:
            ConfigError: If an attribute has nearly the name of a field; the message names it.
        """
        return self._values_and_helpers(cls)[0]

    def _values_and_helpers(self, cls: Any) -> tuple[dict[str, Any], list[str]]:
        """Return the values of a class, and the names of its own attributes."""
        known = {each.script_name for each in self.fields}
        helpers: list[str] = []

        def section_values(section: Any, prefix: str) -> dict[str, Any]:
            entries: dict[str, Any] = {}
            for key in dir(section):
                path, value = f"{prefix}{key}", getattr(section, key)
                if key.startswith("_") or path in self.idle_sections:
                    continue
                if path in known:
                    entries[path] = value
                elif any(other.startswith(f"{path}.") for other in known):
                    entries |= section_values(value, f"{path}.")
                elif isclass(value) or not callable(value):
                    siblings = [name.removeprefix(prefix) for name in known if name.startswith(prefix)]
                    if near := get_close_matches(key, siblings, n=1, cutoff=MISSPELLED):
                        raise ConfigError(
                            f"{_name_of_class(cls)}.{path} = {value!r}: no such field ({self.kind}). Did you mean "
                            f"{prefix + near[0]!r}? Begin the name with an underscore if it is the class's own"
                        )
                    helpers.append(path)
            return entries

        return section_values(cls, ""), helpers

    def translate(self, cls: Any, stands_for: Any, *, base: Any = None) -> Any:
        """Return our configuration for a configuration class. Fields without effect and the class's own attributes are logged.

        Args:
            stands_for: Configuration for a class that is not generated from one.
            base: Configuration that the class changes, whatever it is generated from.

        Raises:
            ConfigError: If an attribute is misspelled, or has a value that means nothing here.
        """
        cfg = base or getattr(cls, STANDS_FOR, stands_for)
        given, helpers = self._values_and_helpers(cls)
        values = {each.script_name: each.read(cfg) for each in self.fields} | given | {STANDS_FOR: cfg}
        changes: Changes = {}
        idle = {"an attribute of its own": helpers} if helpers else {}
        for each in self.fields:
            if each.script_name not in given or values_equal(given[each.script_name], each.read(cfg)):
                continue
            if each.refused:
                told = f"{_name_of_class(cls)}.{each.script_name} = {given[each.script_name]!r}"
                raise ConfigError(f"{told}: {each.remark}")
            if each.write is None:
                idle.setdefault(each.remark, []).append(each.script_name)
            else:
                changes |= each.write(values)
        if idle:
            named = "; ".join(f"{', '.join(names)} ({remark})" for remark, names in idle.items())
            log_once(f"{self.kind} {_name_of_class(cls)}: without effect here: {named}")
        return replace_config_entries(cfg, changes)


def replace_config_entries(cfg: Any, changes: Changes) -> Any:
    """Return a frozen configuration or mapping with entries replaced at all levels in one pass."""
    if cfg is None and changes:
        raise ConfigError(f"{', '.join(changes)}: what this class stands for has none of these to change")
    nested: dict[str, Changes] = {}
    flat: dict[str, Any] = {}
    for path, value in changes.items():
        head, _, rest = path.partition(".")
        if rest:
            nested.setdefault(head, {})[rest] = value
        else:
            flat[head] = as_tuples(value)
    for head, inner in nested.items():
        if isinstance(cfg, Mapping) and head not in cfg:
            raise ConfigError(f"{head}: what this class stands for has none of that name. Known: {', '.join(cfg)}")
        flat[head] = replace_config_entries(cfg[head] if isinstance(cfg, Mapping) else getattr(cfg, head), inner)
    if isinstance(cfg, Mapping):
        return {**cfg, **flat}
    return replace(cfg, **flat) if flat else cfg  # pyright: ignore[reportArgumentType]


def copy_class(config: Any) -> Any:
    """Return a writable subclass of a configuration class, with copies of lists, mappings and nested classes."""
    if not isclass(config):
        return deepcopy(config)
    inner: dict[str, Any] = {}
    for name in dir(config):
        value = getattr(config, name)
        if name.startswith("_"):
            continue
        if isclass(value) and value.__name__ == name:
            inner[name] = copy_class(value)
        elif isinstance(value, (list, dict, set)):
            inner[name] = deepcopy(value)
    return type(config.__name__, (config,), inner)


def as_tuples(value: Any) -> Any:
    """Return lists, arrays and tensors as tuples of Python numbers, other values unchanged."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    return tuple(as_tuples(item) for item in value) if isinstance(value, (list, tuple)) else value


def values_equal(a: Any, b: Any) -> bool:
    """Return whether two values are equal; numbers to a millionth, because they may be written in other units."""
    a, b = as_tuples(a), as_tuples(b)
    if isinstance(a, tuple) or isinstance(b, tuple):
        return _is_sequence(a) and _is_sequence(b) and len(a) == len(b) and all(map(values_equal, a, b))
    if isinstance(a, (int, float)) and isinstance(b, (int, float)):
        return bool(np.isclose(a, b, rtol=1e-6, atol=1e-9, equal_nan=True))
    return bool(a == b)


def _is_sequence(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _name_of_class(cls: Any) -> str:
    return cls.__name__ if isclass(cls) else type(cls).__name__


def _set_attribute(cls: type, path: str, value: object) -> None:
    """Set an attribute of a nested class, which is first derived from the parent's if missing."""
    head, _, rest = path.partition(".")
    if not rest:
        setattr(cls, head, value)
        return
    if head not in vars(cls):
        inherited = getattr(cls, head, None)
        setattr(cls, head, type(head, (inherited,) if inherited else (), {}))
    _set_attribute(vars(cls)[head], rest, value)
