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

plugin_versions: dict[str, str] = {}  # Versions of the packages whose parts this process has used, by name


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

    def summary(self, summarise_file: Callable[[Path], str]) -> str:
        """Return one line about the part, without an import."""
        place = ImportPath(self.place)
        return summarise_file(place.file()) if self.is_file else place.summary()

    def load(self, load_file: Callable[[Path], Any]) -> Any:
        """Return the object of the part; ``load_file`` reads a configuration file."""
        plugin_versions[self.package] = self.version
        place = ImportPath(self.place)
        return load_file(place.file()) if self.is_file else place.load()

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


@cache
def find_plugins() -> Mapping[str, tuple[Plugin, ...]]:
    """Return the plug-ins of all installed packages by kind; parts that cannot be understood are reported."""
    plugins: dict[str, list[Plugin]] = {kind: [] for kind in KINDS}
    if os.environ.get(SWITCH, "0") in ("", "0"):
        for name, package in _packages_with_plugins():
            for plugin in _plugins_of_package(name, package):
                plugins[plugin.kind].append(plugin)
    return {kind: tuple(each) for kind, each in plugins.items()}


def _packages_with_plugins() -> "list[tuple[str, Distribution]]":
    """Return the packages with the group, by name. The text is searched first, as ``importlib.metadata`` takes 50 ms."""
    packages: dict[str, Any] = {}
    for folder in dict.fromkeys(sys.path):
        for file in Path(folder).glob("*-info/entry_points.txt"):
            if GROUP.encode() in file.read_bytes():
                from importlib import metadata

                package = metadata.Distribution.at(file.parent)
                packages.setdefault(package.name or file.parent.name, package)
    return sorted(packages.items())


def _plugins_of_package(package_name: str, package: "Distribution") -> Iterator[Plugin]:
    try:
        points = [point for point in package.entry_points if point.group == GROUP]
    except (TypeError, ValueError) as error:
        log_fault(_describe_fault(package_name, package.version, f"entry_points.txt cannot be read ({error})"))
        return
    for point in points:
        kind, _, name = point.name.partition(".")
        if fault := _fault_of_entry_point(point, kind, name):
            log_fault(_describe_fault(package_name, package.version, f"{point.name} = {point.value!r}: {fault}"))
        else:
            yield Plugin(kind, name, package_name, package.version, point.value)


def _fault_of_entry_point(point: "EntryPoint", kind: str, name: str) -> str:
    if kind not in KINDS:
        return f"no kind {kind!r}.{suggest_name(kind, KINDS)} Known: {', '.join(KINDS)}"
    if not name.isidentifier():
        return f"the name must be KIND.NAME, such as {kind}.my_{kind}"
    module, _, attribute = point.value.partition(":")
    return "" if module.strip() and attribute.strip() else "must be module:object or package:file.yaml"


def instance_converter(place: str) -> Convert:
    """Return the conversion to an instance of the class at ``place``; a class derived from it is called."""

    def convert(name: str, part: Any) -> Any:
        base = ImportPath(place).load()
        entry = part() if isinstance(part, type) and issubclass(part, base) else part
        return _require_fit(name, entry, isinstance(entry, base), base.__name__)

    return convert


def class_converter(place: str | None = None) -> Convert:
    """Return the conversion to a class derived from the one at ``place``; without one, to anything that can be called."""

    def convert(name: str, part: Any) -> Any:
        base = object if place is None else ImportPath(place).load()
        fits = callable(part) if place is None else isinstance(part, type) and issubclass(part, base)
        return _require_fit(name, part, fits, f"class derived from {base.__name__}")

    return convert


def _require_fit(name: str, entry: Any, fits: bool, needs: str) -> Any:
    """Return an entry; refuse one of a wrong type, or one that states another name."""
    own = getattr(entry, "name", None)
    if not fits:
        raise ConfigError(f"{entry!r} is no {needs}")
    if isinstance(own, str) and own not in ("", name):
        raise ConfigError(f"its name is {own!r}. Give both the same name")
    return entry
