"""Public exceptions. Each message names the object, its value, the rule and the remedy."""

from collections.abc import Iterable

LONGEST_SENTENCE = 1200  # Longest message [characters]; longer ones are shortened in the middle
MOST_FAULTS = 20  # Faults that one message lists


class AerialGymError(Exception):
    """Base of every error that this package raises on purpose."""

    def __str__(self) -> str:
        return _shorten(str(self.args[0])) if self.args else ""


def _shorten(text: str) -> str:
    half = LONGEST_SENTENCE // 2
    return text if len(text) <= LONGEST_SENTENCE else f"{text[:half]} ... {text[-half:]}"


class ConfigError(AerialGymError, ValueError):
    """A configuration holds impossible or unknown values; each argument is the sentence of one fault."""

    def __str__(self) -> str:
        if len(self.args) < 2:
            return super().__str__()
        lines = [_shorten(str(fault)) for fault in self.args[:MOST_FAULTS]]
        rest = [f"... and {len(self.args) - MOST_FAULTS} more"] if len(self.args) > MOST_FAULTS else []
        return "\n  ".join((f"{len(self.args)} faults:", *lines, *rest))


class UnknownNameError(AerialGymError, KeyError):
    """A name is not registered."""


class DuplicateNameError(AerialGymError, ValueError):
    """A name is already registered."""


class ShapeError(AerialGymError, ValueError):
    """A tensor does not have the shape, type or device that the call needs."""


class OwnershipError(AerialGymError, TypeError):
    """A tensor of the Global Tensor Dictionary would be replaced instead of written."""


class CapabilityError(AerialGymError, NotImplementedError):
    """A physics backend lacks a requested capability."""


class DataError(AerialGymError, ValueError):
    """A flight log or other data file is unusable."""


class MissingDependencyError(AerialGymError, ImportError):
    """An optional dependency is needed and not installed."""


class StorageError(AerialGymError, OSError):
    """A file cannot be written, because the disk is full or access is denied. The request itself is valid."""


class TrainingError(AerialGymError, RuntimeError):
    """A training stopped: it diverged, or its library failed."""


class ClosedError(AerialGymError, AttributeError):
    """A simulation or a task is used after ``close``."""


def suggest_name(name: object, known: Iterable[str]) -> str:
    """Return a sentence with the most similar known name, after a space; empty if none is similar."""
    from difflib import get_close_matches

    near = get_close_matches(str(name), list(known), n=1)
    return f" Did you mean {near[0]!r}?" if near else ""
