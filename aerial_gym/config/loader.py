"""Conversion between YAML files and frozen dataclasses. Unknown keys are refused with the nearest known one.

One error names all faults of a file: what is missing, unknown, of another type, or out of its range.

Configuration files that build on another: ``extends:`` and the fields that differ.

A base is a file of the package by name, or a path (``.yaml``) relative to the file that names it, and may extend another
one. Mappings are merged into the base, null removes an entry, and other values replace those of the base. For lists of
named entries, such as joints, a mapping gives the changes by name.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from math import inf
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import yaml

from aerial_gym.config import checks
from aerial_gym.config.checks import LARGEST_SINGLE
from aerial_gym.config.sensor_mount import is_file
from aerial_gym.errors import AerialGymError, ConfigError, suggest_name

T = TypeVar("T")

LONGEST_SHOWN = 200  # Characters of a value in a message
PLAIN_NAMES = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", Path: "a path"}
"""Types in messages."""

CONFIG_DIR = Path(__file__).parent  # Folder of the configurations that come with the package


def family_files(family: str) -> dict[str, Path]:
    """Return the files of a family (a folder of ``CONFIG_DIR``, with subfolders) by name."""
    paths = sorted((CONFIG_DIR / family).rglob("*.yaml"), key=lambda path: path.stem)
    return {path.stem: path for path in paths}


_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # The safe loader; in C, ten times as fast, where PyYAML has it


def read_yaml(path: str | Path) -> dict[str, object]:
    """Return the mapping in a YAML file; raise ``ConfigError`` that names the file if there is none."""
    path = Path(path)
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=_Loader)
        recursive = _is_recursive(data, set(), set())
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error})") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: not valid YAML ({' '.join(str(error).split())})") from None
    except RecursionError:
        raise ConfigError(f"{path}: not valid YAML (nested too deeply)") from None
    except (ValueError, ArithmeticError, TypeError) as error:  # what looks like a date or a number, and is none
        raise ConfigError(f"{path}: holds a value that YAML cannot read ({error})") from None
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: must hold a mapping of fields, found {type(data).__name__}")
    if recursive:
        raise ConfigError(f"{path}: not valid YAML (an alias refers to a node that contains it)")
    return data


def _is_recursive(value: object, around: set[int], done: set[int]) -> bool:
    """Return whether a list or mapping contains itself; ``around`` holds its parents, ``done`` those already checked."""
    if not isinstance(value, (dict, list)) or id(value) in done:
        return False
    if id(value) in around:
        return True
    around.add(id(value))
    nested = any(_is_recursive(one, around, done) for one in (value.values() if isinstance(value, dict) else value))
    around.remove(id(value))
    done.add(id(value))
    return nested


def read_summary(path: str | Path) -> str:
    """Return the ``summary`` of a configuration file without building the configuration."""
    return str(read_yaml(path).get("summary", ""))


def load(cls: type[T], path: str | Path) -> T:
    """Return the dataclass ``cls`` filled from a YAML file."""
    return build(cls, read_yaml(path), where=str(path))


def build(cls: type[T], data: Mapping[str, object], *, where: str) -> T:
    """Return the frozen dataclass ``cls`` filled from nested mappings.

    Args:
        cls: A dataclass whose fields are numbers, strings, tuples, mappings, optional values or such dataclasses. Its
            ``MOVED``, if it has one, says of fields that it no longer has what takes their place, ``ABSENT`` of fields that
            it never had.
        where: Named at the start of every error message: a file, or the call.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{where}: must be a mapping of the fields of {cls.__name__}, found {format_value(data)}")
    hints = get_type_hints(cls)
    known = {field.name: field for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
    moved, faults = getattr(cls, "MOVED", {}), list[str]()
    for key in data:
        if key in moved:
            faults.append(f"{where}: field {key!r} is gone: {moved[key]}")
        elif key in getattr(cls, "ABSENT", {}):
            faults.append(f"{where}: field {key!r}: {cls.ABSENT[key]}")  # type: ignore[attr-defined]
        elif key not in known:
            faults.append(f"{where}: unknown field {key!r}.{suggest_name(key, known)} Known: {', '.join(known)}")
    given = [key for key in data if key in known]
    converted, wrong = _convert_all((hints[key], data[key], f"{where}: {key}") for key in given)
    values = dict(zip(given, converted, strict=True))
    for name in mandatory_fields(cls):
        if name not in values:
            values[name] = checks.UNUSABLE
            faults.append(f"{where}: field {name!r} is missing")
    config, refused = _make(cls, values, has_faults=bool(faults or wrong))
    if faults := [*faults, *wrong, *(f"{where}: {fault}" for fault in refused)]:
        raise ConfigError(*faults)
    return config  # type: ignore[return-value]


def _make(cls: type[T], values: Mapping[str, Any], *, has_faults: bool) -> tuple[T | None, list[str]]:
    """Return the dataclass and the faults that its checks find; they pass over values that are unusable."""
    with checks.collect_faults() as faults:
        try:
            return cls(**values), faults
        except Exception as error:
            alone = not (has_faults or faults)
            if isinstance(error, ConfigError) or (isinstance(error, AerialGymError) and not alone):
                faults.extend(error.args)
            elif alone and isinstance(error, (ArithmeticError, ValueError)):
                faults.append(f"impossible numbers ({error})")  # so far apart that a check cannot be computed
            elif alone:
                raise
    return None, faults


def _convert_all(items: Iterable[tuple[Any, Any, str]]) -> tuple[list[Any], list[str]]:
    """Return values converted to their hints, those of the wrong type as unusable, and the faults of these."""
    values, faults = list[Any](), list[str]()
    for hint, value, where in items:
        try:
            values.append(convert(hint, value, where))
        except ConfigError as error:
            values.append(checks.UNUSABLE)
            faults.extend(error.args)
    return values, faults


def _convert_items(items: Iterable[tuple[Any, Any, str]]) -> list[Any]:
    """Return values converted to their hints; raise one ``ConfigError`` with the faults of all."""
    values, faults = _convert_all(items)
    if faults:
        raise ConfigError(*faults)
    return values


def mandatory_fields(cls: type) -> list[str]:
    """Return the names of the fields of a dataclass without a default."""
    missing = dataclasses.MISSING
    return [f.name for f in dataclasses.fields(cls) if f.default is missing and f.default_factory is missing]


def to_mapping(config: object) -> dict[str, Any]:
    """Return the nested mapping from which ``build`` makes the same dataclass again, ready for YAML."""
    return {f.name: _plain_value(getattr(config, f.name)) for f in dataclasses.fields(config)}  # type: ignore[arg-type]


class _Dumper(yaml.SafeDumper):
    """Writes a list of numbers in one line: ``[0.0, 0.0, 1.0]``."""


def _represent_list(dumper: _Dumper, values: list[Any]) -> yaml.SequenceNode:
    numbers = all(isinstance(value, (int, float)) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=numbers)


_Dumper.add_representer(list, _represent_list)


def dump_yaml(config: object) -> str:
    """Return a dataclass as YAML text."""
    return yaml.dump(to_mapping(config), Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)


def _plain_value(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_mapping(value)
    if isinstance(value, Mapping):
        return {str(key): _plain_value(item) for key, item in value.items()}
    return [_plain_value(item) for item in value] if isinstance(value, (tuple, list)) else value


def convert(hint: Any, value: Any, where: str) -> Any:
    """Return a value converted to a type hint; ``where`` is the prefix of errors."""
    if hint is object:
        return _convert_untyped(value, where)
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return _convert_optional(args, value, where)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return value if isinstance(value, hint) else build(hint, value, where=where)
    if origin is Literal:
        if value not in args:
            raise ConfigError(f"{where} = {format_value(value)}: must be {' or '.join(map(repr, args))}")
        return value
    if origin is tuple:
        return _convert_tuple(args, value, where)
    if origin in (dict, Mapping) or (isinstance(origin, type) and issubclass(origin, Mapping)):
        if not isinstance(value, Mapping):
            raise ConfigError(f"{where} = {format_value(value)}: must be a mapping")
        keys = _convert_items((args[0], key, where) for key in value)
        return dict(zip(keys, _convert_items((args[1], v, f"{where}.{k}") for k, v in value.items()), strict=True))
    return _convert_scalar(hint, value, where)


def _convert_untyped(value: Any, where: str) -> Any:
    """Return numbers, texts, booleans and lists of them unconverted, for fields without a fixed type."""
    if isinstance(value, (list, tuple)):
        return tuple(_convert_untyped(item, f"{where}[{i}]") for i, item in enumerate(value))
    if isinstance(value, (int, float)) and LARGEST_SINGLE < abs(value) < inf:
        raise ConfigError(f"{where} = {format_value(value)}: must be at most {LARGEST_SINGLE:.2g} either way")
    if isinstance(value, (str, int, float)):
        return value
    raise ConfigError(f"{where} = {format_value(value)}: must be a number, a text, or a list of such")


def _convert_optional(args: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and NoneType in args:
        return None
    rest = [arg for arg in args if arg is not NoneType]
    structures = [arg for arg in rest if dataclasses.is_dataclass(arg)]
    if len(rest) > 1 and structures:  # a plain value or fields
        takes_fields = isinstance(value, Mapping) or dataclasses.is_dataclass(value)
        rest = structures if takes_fields else [arg for arg in rest if arg not in structures]
    lists = [arg for arg in rest if get_origin(arg) is tuple]
    if len(rest) > 1 and lists:  # a number or several
        rest = lists if isinstance(value, (list, tuple)) else [arg for arg in rest if arg not in lists]
    return convert(rest[0], value, where)


def _convert_tuple(args: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)):
        raise ConfigError(f"{where} = {format_value(value)}: must be a list")
    if len(args) == 2 and args[1] is Ellipsis:
        return tuple(_convert_items((args[0], item, f"{where}[{i}]") for i, item in enumerate(value)))
    if len(value) != len(args):
        raise ConfigError(f"{where} = {format_value(value)}: must have {len(args)} entries")
    pairs = enumerate(zip(args, value, strict=True))
    return tuple(_convert_items((arg, item, f"{where}[{i}]") for i, (arg, item) in pairs))


def _convert_scalar(hint: Any, value: Any, where: str) -> Any:
    if hint is float and isinstance(value, str):
        with suppress(ValueError):
            value = float(value)  # such as ``1e-5``, which YAML 1.1 reads as text
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise ConfigError(f"{where} = {format_value(value)}: must be a finite number") from None
    if hint is int and isinstance(value, int) and not isinstance(value, bool):
        if not -(2**63) <= value < 2**63:
            raise ConfigError(f"{where} = {format_value(value)}: must fit into 64 bits")
        return value
    if hint is Path and isinstance(value, (str, Path)):
        return Path(value)
    if hint in (str, bool) and isinstance(value, hint):
        return value
    raise ConfigError(f"{where} = {format_value(value)}: must be {PLAIN_NAMES.get(hint, hint)}")


def format_value(value: object) -> str:
    """Return the Python text of a value for messages, shortened to ``LONGEST_SHOWN`` characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # an integer of thousands of digits, brackets in brackets
        return f"a {type(value).__name__} that is too long to show"
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."


def load_extended(
    cls: type[T], path: str | Path, *, family: str, located: Callable[[T, Path], T] = lambda cfg, _: cfg,
    base: Path | None = None,
) -> T:  # fmt: skip
    """Return the dataclass ``cls`` filled from a YAML file and those that it builds on.

    Args:
        family: Folder of the package in which, and in whose rooms, names are looked up.
        located: Returns a configuration whose paths, relative to a folder, are found from anywhere.
        base: File that the first one extends if it names none.
    """
    return _load_file(cls, Path(path), family, located, (), base)


def _load_file(
    cls: type[T], path: Path, family: str, located: Callable[[T, Path], T], above: tuple[Path, ...],
    base: Path | None = None,
) -> T:  # fmt: skip
    data, resolved = read_yaml(path), path.resolve()
    if base is not None:
        data.setdefault("extends", str(base))
    if resolved in above:
        names = " -> ".join(file.name for file in (*above[above.index(resolved) :], resolved))
        raise ConfigError(f"{path}: extends itself ({names})")
    if "extends" in data:
        extended = _load_file(cls, _base_file(path, data.pop("extends"), family), family, located, (*above, resolved))
        data = _overlay(to_mapping(extended), data, str(path))
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
