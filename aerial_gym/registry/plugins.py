"""Plug-ins: parts of other installed packages, by the entry point group ``aerial_gym.plugins``.

An entry point ``KIND.NAME = "module:object"``, or ``"package:file.yaml"`` for a configuration, adds one part. Names, packages
and summaries come from metadata and source; the code of a plug-in is imported at the first use of the part.
"""

import os
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerial_gym.errors import AerialGymError, ConfigError, suggest_name
from aerial_gym.lazy import ImportPath

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

GROUP = "aerial_gym.plugins"
SWITCH = "AERIAL_GYM_NO_PLUGINS"  # Environment variable that turns plug-ins off if it is neither empty nor 0

KINDS = (
    "action", "backend", "buffer", "command", "control_law", "controller", "effect", "environment", "imu", "log_reader",
    "observation", "reward", "robot", "rotor_map", "sensor", "shape", "sim", "task", "termination", "trainer",
)  # fmt: skip
"""All kinds, each of the registry that accepts it."""

Convert = Callable[[str, Any], Any]  # From the name and the object of a part to the entry of a registry

_versions: dict[str, str] = {}


@dataclass(frozen=True)
class Plugin:
    """A part of another package."""

    kind: str
    name: str
    package: str  # Name of the distribution
    version: str
    place: str  # ``module:object`` or ``package:file.yaml``

    @property
    def is_file(self) -> bool:
        """Whether the part is a configuration file."""
        return self.place.endswith((".yaml", ".yml"))

    @property
    def is_imported(self) -> bool:
        """Whether its module is imported, so that it may have registered the part itself."""
        return not self.is_file and self.place.partition(":")[0] in sys.modules

    def summary(self) -> str:
        """Return one line about the part, without an import."""
        if not self.is_file:
            return ImportPath(self.place).summary()
        from aerial_gym.config.loader import read_summary

        return read_summary(ImportPath(self.place).file())

    def load(self, load_file: Callable[[Path], Any] | None) -> Any:
        """Return the object of the part; ``load_file`` reads its configuration file."""
        _versions[self.package] = self.version
        if not self.is_file:
            return ImportPath(self.place).load()
        if load_file is None:
            raise ConfigError(f"a {self.kind} is no file. Give module:object")
        return load_file(ImportPath(self.place).file())

    def failure(self, error: BaseException) -> str:
        """Return the line on an error of this part."""
        reason = " ".join(str(error).split())
        reason = reason if isinstance(error, AerialGymError) else f"{type(error).__name__}: {reason}"
        return _describe_fault(self.package, self.version, f"{self.kind} {self.name!r} ({self.place}): {reason}")


def _describe_fault(package: str, version: str, fault: str) -> str:
    return f"plug-in package {package} {version}: {fault.rstrip('.')}. It is left out"


def log_fault(line: str) -> None:
    """Log a line on a plug-in; without other settings it goes to stderr."""
    import logging

    logging.getLogger(__name__).warning(line)


def loaded_versions() -> dict[str, str]:
    """Return the versions of the packages whose parts this process has used, by name."""
    return dict(sorted(_versions.items()))


@cache
def find_plugins() -> Mapping[str, tuple[Plugin, ...]]:
    """Return the plug-ins of all installed packages by kind; parts that cannot be understood are reported."""
    plugins: dict[str, list[Plugin]] = {kind: [] for kind in KINDS}
    if os.environ.get(SWITCH, "0") in ("", "0"):
        for package in _packages_with_plugins():
            for plugin in _plugins_of_package(package):
                plugins[plugin.kind].append(plugin)
    return {kind: tuple(each) for kind, each in plugins.items()}


def _packages_with_plugins() -> "Iterator[Distribution]":
    """Yield the packages with the group, by name. The text is searched first, as ``importlib.metadata`` takes 50 ms."""
    packages = {}
    for folder in map(Path, dict.fromkeys(sys.path)):
        names = os.listdir(folder) if folder.is_dir() else ()
        for path in (folder / name for name in sorted(names) if name.endswith(("-info", ".egg-info"))):
            try:
                is_one = GROUP.encode() in (path / "entry_points.txt").read_bytes()
            except OSError:
                continue
            if is_one:
                from importlib.metadata import Distribution

                package = Distribution.at(path)
                packages.setdefault(package.name or path.stem, package)
    yield from (packages[name] for name in sorted(packages))


def _plugins_of_package(package: "Distribution") -> Iterator[Plugin]:
    for point in package.entry_points:
        if point.group == GROUP:
            kind, _, name = point.name.partition(".")
            if fault := _fault_of_entry_point(point, kind, name):
                log_fault(_describe_fault(package.name, package.version, f"{point.name} = {point.value!r}: {fault}"))
            else:
                yield Plugin(kind, name, package.name, package.version, point.value)


def _fault_of_entry_point(point: "EntryPoint", kind: str, name: str) -> str:
    if kind not in KINDS:
        return f"no kind {kind!r}.{suggest_name(kind, KINDS)} Known: {', '.join(KINDS)}"
    if not name.isidentifier():
        return f"the name must be KIND.NAME, such as {kind}.my_{kind}"
    module, _, attribute = point.value.partition(":")
    return "" if module.strip() and attribute.strip() else "must be module:object or package:file.yaml"


def instances_of(place: str) -> Convert:
    """Return the conversion to an instance of the class at ``place``; a class derived from it is called."""

    def convert(name: str, part: Any) -> Any:
        base = ImportPath(place).load()
        entry = part() if isinstance(part, type) and issubclass(part, base) else part
        if not isinstance(entry, base):
            raise ConfigError(f"is {_describe_type(part)}, needs {base.__name__}")
        return _require_name(name, entry)

    return convert


def classes_of(place: str | None = None) -> Convert:
    """Return the conversion to a class derived from the one at ``place``; anything that can be called without one."""

    def convert(name: str, part: Any) -> Any:
        base = None if place is None else ImportPath(place).load()
        if not (callable(part) if base is None else isinstance(part, type) and issubclass(part, base)):
            raise ConfigError(
                f"is {_describe_type(part)}, needs a class{f' derived from {base.__name__}' if base else ''}"
            )
        return _require_name(name, part)

    return convert


def _describe_type(part: object) -> str:
    return f"the class {part.__name__}" if isinstance(part, type) else f"a {type(part).__name__}"


def _require_name(name: str, entry: Any) -> Any:
    """Return an entry; refuse one that states another name."""
    own = getattr(entry, "name", None)
    if isinstance(own, str) and own not in ("", name):
        raise ConfigError(f"its name is {own!r}. Give both the same name")
    return entry
