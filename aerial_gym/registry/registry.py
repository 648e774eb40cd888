"""One class for every family of names: sims, environments, robots, controllers, sensors, effects, backends, tasks."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar, cast

from aerial_gym.errors import DuplicateNameError, UnknownNameError, suggest_name

T = TypeVar("T")


@dataclass(frozen=True)
class _LazyEntry(Generic[T]):
    """An entry before its first use."""

    make: Callable[[], T]
    summary: Callable[[], str] | None


class Registry(Generic[T]):
    """Immutable entries under unique ``snake_case`` names, in order of registration."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._entries: dict[str, T | _LazyEntry[T]] = {}

    @property
    def kind(self) -> str:
        """Name of an entry's kind in error messages."""
        return self._kind

    def register(self, name: str, entry: T) -> None:
        """Add an entry; raise ``DuplicateNameError`` if the name is taken."""
        if name in self._entries:
            raise DuplicateNameError(f"{self._kind} {name!r} is registered already. Choose another name.")
        self._entries[name] = entry

    def register_later(self, name: str, make: Callable[[], T], *, summary: Callable[[], str] | None = None) -> None:
        """Add an entry that is made at its first use; ``summary`` returns one line about the entry without making it."""
        self.register(name, _LazyEntry(make, summary))  # type: ignore[arg-type]

    def get(self, name: str) -> T:
        """Return the entry, or raise ``UnknownNameError`` that lists what exists."""
        try:
            entry = self._entries[name]
        except KeyError:
            known = ", ".join(sorted(self._entries)) or "none"
            raise UnknownNameError(
                f"no {self._kind} {name!r}.{suggest_name(name, self._entries)} Known: {known}"
            ) from None
        if isinstance(entry, _LazyEntry):
            entry = self._entries[name] = entry.make()
        return cast("T", entry)

    def summaries(self) -> dict[str, str]:
        """Return one line about each entry, by name, sorted: its ``summary``, or the first line of its docstring."""
        return {name: self._summary(name) for name in self.names()}

    def _summary(self, name: str) -> str:
        entry = self._entries[name]
        if isinstance(entry, _LazyEntry) and entry.summary is not None:
            return entry.summary()
        entry = self.get(name)
        return getattr(entry, "summary", None) or (entry.__doc__ or "").partition("\n")[0]

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted."""
        return tuple(sorted(self._entries))

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)


def register_files(
    registry: Registry[T], files: Mapping[str, Path], load: Callable[[Path], T], *, summary: Callable[[Path], str]
) -> None:
    """Add files by name, each loaded at its first use; ``summary`` returns one line about a file without loading it."""
    for name, path in files.items():
        registry.register_later(name, partial(load, path), summary=partial(summary, path))
