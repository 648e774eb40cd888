"""One class for every family of names: sims, environments, robots, controllers, sensors, effects, backends, tasks."""

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Generic, TypeVar

from aerial_gym.errors import DuplicateNameError, UnknownNameError

T = TypeVar("T")


class Registry(Generic[T]):
    """Immutable entries under unique ``snake_case`` names, in order of registration."""

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._entries: dict[str, T] = {}

    @property
    def kind(self) -> str:
        """What the entries are, as error messages call them."""
        return self._kind

    def register(self, name: str, entry: T) -> None:
        """Add an entry; raise ``DuplicateNameError`` if the name is taken."""
        if name in self._entries:
            raise DuplicateNameError(f"{self._kind} {name!r} is registered already. Choose another name.")
        self._entries[name] = entry

    def get(self, name: str) -> T:
        """Return the entry, or raise ``UnknownNameError`` that lists what exists."""
        try:
            return self._entries[name]
        except KeyError:
            near = get_close_matches(name, self._entries, n=1)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            known = ", ".join(sorted(self._entries)) or "none"
            raise UnknownNameError(f"no {self._kind} {name!r}.{hint} Known: {known}") from None

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted."""
        return tuple(sorted(self._entries))

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)
