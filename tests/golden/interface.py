"""Golden results of the interface: registered names, commands with their flags, configuration keys, Python signatures."""

import ast
import contextlib
import inspect
import io
import json
import os
import re
from collections.abc import Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, get_args, get_type_hints

import aerial_gym
from aerial_gym.cli.list_names import KINDS, ON_REQUEST
from aerial_gym.cli.main import COMMANDS, main
from aerial_gym.lazy import ImportPath
from aerial_gym.physics import EFFECTS
from aerial_gym.registry import Registry

TOLERANCE_ELSEWHERE = 0.0
"""Nothing here depends on the machine."""

HAS_PROSE = False

MODULES = (
    "", "config", "registry", "physics", "assets", "control", "sensors", "robots", "env_manager", "task", "rl_training",
    "sim2real", "export", "compat",
)  # fmt: skip
"""Packages whose ``__all__`` users import from."""

CONFIGURATIONS = {
    "robot": "aerial_gym.config.robot:RobotCfg",
    "environment": "aerial_gym.config.environment:EnvironmentCfg",
    "sim": "aerial_gym.config.sim:SimCfg",
    "task": "aerial_gym.config.task:TaskCfg",
    "camera": "aerial_gym.config.sensor:CameraCfg",
    "stereo camera": "aerial_gym.config.sensor:StereoCfg",
    "fisheye": "aerial_gym.config.sensor:FisheyeCfg",
    "lidar": "aerial_gym.config.lidar:LidarCfg",
    "ray table": "aerial_gym.config.lidar:RayTableCfg",
    "rosette": "aerial_gym.config.lidar:RosetteCfg",
    "imu": "aerial_gym.config.sensor:ImuCfg",
    "training": "aerial_gym.rl_training.settings:TrainingCfg",
    "encoder": "aerial_gym.rl_training.encoder.settings:EncoderTrainingCfg",
    "tolerances": "aerial_gym.sim2real.predict.tolerances:Tolerances",
    "mapping": "aerial_gym.sim2real.logs.readers.mapping:LogMapping",
}
"""Classes of the files that users write."""


def items() -> dict[str, bool]:
    """Return the names of all results; all are quick."""
    return dict.fromkeys(("names", "commands", "configuration", "python"), True)


def measure(item: str) -> dict[str, Any]:
    """Return one of the lists."""
    return {"names": _names, "commands": _commands, "configuration": _configuration, "python": _python}[item]()


def _command_output(*argv: str) -> str:
    """Return the output of a command on a wide terminal."""
    os.environ["COLUMNS"] = "1000"
    with contextlib.redirect_stdout(io.StringIO()) as out:
        status = main(argv)
    return out.getvalue() if status == 0 else f"exit status {status}"


def _names() -> dict[str, Any]:
    """Return the names of each kind, whose summaries must not be empty, and the parameters of each effect."""
    result: dict[str, Any] = {}
    for kind in (*KINDS, *ON_REQUEST):
        told = json.loads(_command_output("list", kind, "--json"))
        for name, lines in told.items():
            result[name] = list(lines)
            result |= {f"{name}/{entry}/summary": "empty" for entry, line in lines.items() if not line.strip()}
    result["kinds"] = list(json.loads(_command_output("list", "--json")))
    return result | {f"effects/{name}": [p.name for p in EFFECTS.get(name).parameters] for name in EFFECTS.names()}


def _commands() -> dict[str, Any]:
    """Return the flags of each command and of what stands below it, with type and default."""
    result: dict[str, Any] = {}
    waiting = [(name,) for name in COMMANDS]
    while waiting:
        command = waiting.pop(0)
        text = _command_output(*command, "--help")
        result[" ".join(command)] = list(_flags(text))
        waiting += [(*command, name) for name in re.findall(r"• (\S+)", text)]
    return result


def _flags(text: str) -> Iterator[str]:
    """Yield head and default of each argument in a help text; a head stands two spaces from the left."""
    for part in re.split(r"\n  (?=-|\[|\{|[A-Z]{2,}|[a-z_]+  )", text)[1:]:
        if part.startswith("-h"):
            continue
        default = re.search(r"\((?:default: [^)]*|required)\)", part)
        yield " ".join([re.split(r"  +|\n", part)[0], *([default[0]] if default else [])])


def _configuration() -> dict[str, Any]:
    """Return every key of the configurations, with its default; a class that several keys hold is listed once."""
    result: dict[str, Any] = {}
    known: set[type] = set()
    waiting = [(root, ImportPath(place).load()) for root, place in CONFIGURATIONS.items()]
    while waiting:
        path, cls = waiting.pop(0)
        if cls in known:
            continue
        known.add(cls)
        hints = get_type_hints(cls)
        for field in (each for each in fields(cls) if each.init):
            key = f"{path}.{field.name}"
            result[key] = _default(field)
            waiting += [(key, each) for each in _classes(hints[field.name])]
    return result


def _classes(hint: Any) -> Iterator[type]:
    """Yield the dataclasses in a type."""
    if isinstance(hint, type) and is_dataclass(hint):
        yield hint
    for part in get_args(hint):
        yield from _classes(part)


def _default(field: Any) -> Any:
    if field.default_factory is not MISSING:
        return "{}"
    return "required" if field.default is MISSING else _plain(field.default)


def _plain(value: Any) -> str:
    """Return a default as text: numbers, names and sequences of them; of anything else, that there is one."""
    if isinstance(value, tuple | list):
        return f"({', '.join(_plain(part) for part in value)})"
    return repr(value) if isinstance(value, bool | int | float | str | None) else "..."


def _python() -> dict[str, Any]:
    """Return the names in the public packages with their signatures; of classes, those of public methods as well."""
    result: dict[str, Any] = {}
    for module in MODULES:
        package = import_module(f"aerial_gym.{module}".rstrip("."))
        for name in package.__all__:
            result[f"{package.__name__}.{name}"] = _describe(getattr(package, name))
    errors = import_module("aerial_gym.errors")
    result["aerial_gym.errors"] = {
        name: [base.__name__ for base in cls.__mro__[1:-1]]
        for name, cls in vars(errors).items()
        if isinstance(cls, type) and cls.__module__ == errors.__name__
    }
    for path in sorted((Path(aerial_gym.__file__).parent / "rl_training" / "adapters").glob("[!_]*.py")):
        classes = [n for n in ast.parse(path.read_text(encoding="utf-8")).body if isinstance(n, ast.ClassDef)]
        result[f"aerial_gym.rl_training.adapters.{path.stem}"] = [c.name for c in classes if not c.name.startswith("_")]
    return result


def _describe(value: Any) -> Any:
    if inspect.isclass(value):
        members = ((n, m) for n, m in inspect.getmembers(value) if not n.startswith("_") and _is_package_member(m))
        return {"()": _signature(value), **{n: _signature(m) for n, m in members}}
    if callable(value) and not isinstance(value, Registry):
        return _signature(value)
    return "registry" if isinstance(value, Registry) else "value"


def _is_package_member(member: Any) -> bool:
    """Return whether a member of a class is a property, or a function of this package."""
    if isinstance(member, property | cached_property):
        return True
    return callable(member) and str(getattr(member, "__module__", "")).startswith("aerial_gym")


def _signature(value: Any) -> str:
    """Return the names and defaults of parameters, without annotations."""
    if isinstance(value, property | cached_property):
        return "property"
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return "callable"
    bare = [
        p.replace(annotation=p.empty, default=p.default if p.default is p.empty else _Text(_plain(p.default)))
        for p in signature.parameters.values()
    ]
    return str(signature.replace(parameters=bare, return_annotation=inspect.Signature.empty))


class _Text(str):
    """A default whose form in a signature is its own text."""

    def __repr__(self) -> str:
        return str(self)
