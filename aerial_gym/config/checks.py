"""What every configuration checks of its numbers."""

from math import inf

import numpy as np

from aerial_gym.errors import ConfigError

Vec3 = tuple[float, float, float]


def require_positive(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named fields are finite and > 0 (NaN fails as well)."""
    for name in names:
        value = getattr(config, name)
        if not 0.0 < value < inf:
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: must be > 0 and finite")


def require_finite(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers or nested tuples of numbers are finite."""
    for name in names:
        value = getattr(config, name)
        if not np.all(np.isfinite(np.asarray(value, dtype=float))):
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: must be finite")


def require_ordered(config: object, low: str, high: str) -> None:
    """Raise ``ConfigError`` unless every entry of field ``low`` is at most its partner in field ``high``."""
    a, b = np.asarray(getattr(config, low), dtype=float), np.asarray(getattr(config, high), dtype=float)
    if not np.all(a <= b):
        raise ConfigError(f"{type(config).__name__}: {low} = {a.tolist()} must not exceed {high} = {b.tolist()}")
