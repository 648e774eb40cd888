"""Exceptions that users see. Every message names the thing, its value, the rule and the way out."""


class AerialGymError(Exception):
    """Base of every error that this package raises on purpose."""


class ConfigError(AerialGymError, ValueError):
    """A configuration holds an impossible or unknown value."""


class UnknownNameError(AerialGymError, KeyError):
    """A name that no registry holds."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


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
