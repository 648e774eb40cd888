"""Exceptions that users see. Every message names the thing, its value, the rule and the remedy."""

from collections.abc import Iterable

LONGEST_SENTENCE = 1200
"""Characters of a message; a value of thousands of characters that it names is cut out of its middle."""


class AerialGymError(Exception):
    """Base of every error that this package raises on purpose."""

    def __str__(self) -> str:
        text = str(self.args[0]) if self.args else ""
        half = LONGEST_SENTENCE // 2
        return text if len(text) <= LONGEST_SENTENCE else f"{text[:half]} ... {text[-half:]}"


class ConfigError(AerialGymError, ValueError):
    """A configuration holds an impossible or unknown value."""


class UnknownNameError(AerialGymError, KeyError):
    """A name that no registry holds."""


class DuplicateNameError(AerialGymError, ValueError):
    """A name that is registered already."""


class ShapeError(AerialGymError, ValueError):
    """A tensor does not have the shape, type or device that the call needs."""


class OwnershipError(AerialGymError, TypeError):
    """A tensor of the Global Tensor Dictionary would be replaced instead of written."""


class CapabilityError(AerialGymError, NotImplementedError):
    """A physics backend cannot run what was asked of it."""


class DataError(AerialGymError, ValueError):
    """A flight log or another data file cannot be used as it is."""


class MissingDependencyError(AerialGymError, ImportError):
    """An optional dependency is needed and not installed."""


class StorageError(AerialGymError, OSError):
    """A file cannot be written: the disk is full, or the system does not allow it. The request was right."""


class TrainingError(AerialGymError, RuntimeError):
    """A training cannot go on: it diverged, or the library that trains gave up."""


class ClosedError(AerialGymError, AttributeError):
    """A simulation or a task is used after ``close``."""


def did_you_mean(name: object, known: Iterable[str]) -> str:
    """Return the sentence that names the nearest known name, after a space; nothing if none is near."""
    from difflib import get_close_matches

    near = get_close_matches(str(name), list(known), n=1)
    return f" Did you mean {near[0]!r}?" if near else ""
