"""Checks of numbers that all configurations share."""

from collections.abc import Iterator
from math import inf, isfinite

from aerial_gym.errors import ConfigError

MAX_COUNT = 2**31 - 1
"""Kernels count with 32 bits."""

MAX_MADE = 10**6
"""Things that are made one by one, such as shapes and rows of obstacles of one environment."""

LARGEST_SINGLE = (2.0 - 2.0**-23) * 2.0**127
"""The largest number of single precision, in which tasks count."""

Vec3 = tuple[float, float, float]


def require_positive(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers are finite and > 0, or None (NaN fails)."""
    for name in names:
        value = getattr(config, name)
        if value is not None and not 0.0 < value < inf:
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: must be > 0 and finite")


def require_not_negative(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers, or tuples of numbers, are finite and >= 0, or None (NaN fails)."""
    for name in names:
        value = getattr(config, name)
        if value is not None and not all(0.0 <= number < inf for number in _numbers(value)):
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: must be >= 0 and finite")


def require_finite(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers or nested tuples of numbers are finite."""
    for name in names:
        value = getattr(config, name)
        if not all(map(isfinite, _numbers(value))):
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: must be finite")


def require_float32(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers are finite in single precision (NaN fails as well)."""
    for name in names:
        value = getattr(config, name)
        if not abs(value) <= LARGEST_SINGLE:
            raise ConfigError(
                f"{type(config).__name__}.{name} = {value!r}: must be finite, and at most {LARGEST_SINGLE:.2g} either way"
            )


def require_count(config: object, *names: str, most: int = MAX_COUNT) -> None:
    """Raise ``ConfigError`` unless the named whole numbers are from 1 to ``most``."""
    for name in names:
        value = getattr(config, name)
        if not 1 <= value <= most:
            raise ConfigError(f"{type(config).__name__}.{name} = {value!r}: must be >= 1 and at most {most:,}")


def require_ordered(config: object, low: str, high: str) -> None:
    """Raise ``ConfigError`` unless every entry of field ``low`` is at most its partner in field ``high``."""
    a, b = list(_numbers(getattr(config, low))), list(_numbers(getattr(config, high)))
    if not all(x <= y for x, y in zip(a, b, strict=True)):
        raise ConfigError(f"{type(config).__name__}: {low} = {a} must not exceed {high} = {b}")


def _numbers(value: object) -> Iterator[float]:
    """Yield the numbers of a number or of nested tuples."""
    if isinstance(value, (tuple, list)):
        for item in value:
            yield from _numbers(item)
    else:
        yield float(value)  # type: ignore[arg-type]
