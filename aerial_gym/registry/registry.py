"""One class for every family of names: sims, environments, robots, controllers, sensors, effects, backends, tasks."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar, cast

from aerial_gym.errors import ConfigError, DuplicateNameError, UnknownNameError, suggest_name
from aerial_gym.registry.plugins import Plugin, find_plugins, log_fault

T = TypeVar("T")


@dataclass(frozen=True)
class _LazyEntry(Generic[T]):
    """An entry before its first use."""

    make: Callable[[], T]
    summary: Callable[[], str] | None


class Registry(Generic[T]):
    """Immutable entries under unique ``snake_case`` names, in order of registration. Plug-ins are added at its first use."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._entries: dict[str, T | _LazyEntry[T]] = {}
        self._plugin_kinds: dict[str, Callable[[str, Any], T]] = {}
        self._plugins: dict[str, Plugin] = {}
        self._own_names: frozenset[str] = frozenset()
        self._has_plugins = True
        self.load_file: Callable[[Path], T] = _refuse_file  # Reads an entry from a configuration file
        self.summarise_file: Callable[[Path], str] = _refuse_file  # Reads only the line about it

    @property
    def kind(self) -> str:
        """Name of an entry's kind in error messages."""
        return self._kind

    def register(self, name: str, entry: T) -> None:
        """Add an entry; raise ``DuplicateNameError`` if the name is taken. A plug-in's module may register its own part."""
        waits = isinstance(self._entries.get(name), _LazyEntry) and name in self._plugins
        if name in self._entries and not (waits and self._plugins[name].is_imported):
            owner = f" by {self._owner(name)}" if name in self._plugins else ""
            raise DuplicateNameError(f"{self._kind} {name!r} is registered already{owner}. Choose another name.")
        self._entries[name] = entry

    def register_later(self, name: str, make: Callable[[], T], *, summary: Callable[[], str] | None = None) -> None:
        """Add an entry that is made at its first use; ``summary`` returns one line about the entry without making it."""
        self.register(name, _LazyEntry(make, summary))  # type: ignore[arg-type]

    def accept_plugins(self, **kinds: Callable[[str, Any], T]) -> None:
        """Add the parts of other packages at the next use, after all entries of this package.

        Args:
            kinds: For each kind of plug-in the conversion from its name and object to an entry, which raises ``ConfigError``.
        """
        self._plugin_kinds, self._has_plugins, self._own_names = kinds, False, frozenset(self._entries)

    def _all_entries(self) -> dict[str, T | _LazyEntry[T]]:
        """Return the entries, with those of plug-ins."""
        if not self._has_plugins:
            self._has_plugins = True
            for kind, convert in self._plugin_kinds.items():
                for plugin in find_plugins()[kind]:
                    self._add_plugin(plugin, convert)
        return self._entries

    def _add_plugin(self, plugin: Plugin, convert: Callable[[str, Any], T]) -> None:
        if plugin.name not in self._entries:
            make = partial(self._make_plugin, plugin, convert)
            self._entries[plugin.name] = _LazyEntry(make, partial(plugin.summary, self.summarise_file))
        elif not plugin.is_imported:  # an imported module may have registered its part itself
            taken = DuplicateNameError(f"the name is taken by {self._owner(plugin.name)}. Choose another one")
            log_fault(plugin.failure(taken))
            return
        self._plugins[plugin.name] = plugin

    def _owner(self, name: str) -> str:
        if name in self._plugins:
            return f"package {self._plugins[name].package}"
        return "package aerial-gym" if name in self._own_names else "this program"

    def _make_plugin(self, plugin: Plugin, convert: Callable[[str, Any], T]) -> T:
        part = plugin.load(self.load_file)
        entry = self._entries[plugin.name]
        return convert(plugin.name, part) if isinstance(entry, _LazyEntry) else entry

    def get(self, name: str) -> T:
        """Return the entry, or raise ``UnknownNameError`` that lists what exists, or says why a plug-in cannot be loaded."""
        try:
            entry = self._all_entries()[name]
        except KeyError:
            known = ", ".join(sorted(self._entries)) or "none"
            raise UnknownNameError(
                f"no {self._kind} {name!r}.{suggest_name(name, self._entries)} Known: {known}"
            ) from None
        if isinstance(entry, _LazyEntry):
            try:
                entry = self._entries[name] = entry.make()
            except (Exception, SystemExit) as error:
                if name not in self._plugins:
                    raise
                raise UnknownNameError(self._plugins[name].failure(error)) from error
        return cast("T", entry)

    def summaries(self) -> dict[str, str]:
        """Return one line about each entry, by name, sorted: its ``summary``, or the first line of its docstring."""
        lines = {name: self._summary(name) for name in self.names()}
        return {name: line for name, line in lines.items() if line is not None}

    def _summary(self, name: str) -> str | None:
        """Return the line about an entry; None of a plug-in that is reported and left out."""
        entry = self._entries[name]
        if isinstance(entry, _LazyEntry) and entry.summary is not None:
            try:
                return entry.summary()
            except Exception as error:
                if name not in self._plugins:
                    raise
                return self._leave_out(name, self._plugins[name].failure(error))
        entry = self.get(name)
        return getattr(entry, "summary", None) or (entry.__doc__ or "").partition("\n")[0]

    def _leave_out(self, name: str, line: str) -> None:
        """Report a plug-in that cannot be used, and forget it."""
        log_fault(line)
        del self._plugins[name], self._entries[name]

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted, also of plug-ins that cannot be loaded; iterate over the registry for the others."""
        return tuple(sorted(self._all_entries()))

    def packages(self) -> dict[str, str]:
        """Return the packages of the plug-ins by name."""
        return {name: self._plugins[name].package for name in self.names() if name in self._plugins}

    def __repr__(self) -> str:
        return f"Registry: {len(self)} entries of kind {self._kind}: {', '.join(self.names())}"

    def __contains__(self, name: object) -> bool:
        return name in self._all_entries()

    def __iter__(self) -> Iterator[str]:
        """Yield the names of entries. Plug-ins are loaded for that; one that fails is reported once and left out."""
        for name in list(self._all_entries()):
            if name in self._plugins:
                try:
                    self.get(name)
                except UnknownNameError as error:
                    self._leave_out(name, str(error))
                    continue
            yield name

    def __len__(self) -> int:
        return len(self._all_entries())


def _refuse_file(path: Path) -> NoReturn:
    raise ConfigError(f"{path.name}: entries of this kind are no files. Give module:object")


def register_files(
    registry: Registry[T], files: Mapping[str, Path], load: Callable[[Path], T], *, summary: Callable[[Path], str]
) -> None:
    """Add files by name, each loaded at its first use; ``summary`` returns one line about a file without loading it."""
    registry.load_file, registry.summarise_file = load, summary
    for name, path in files.items():
        registry.register_later(name, partial(load, path), summary=partial(summary, path))
