"""Checks of numbers that all configurations share.

A check raises ``ConfigError``. While a file is read, ``collect_faults`` collects all faults of a configuration instead. A
missing or refused value is then ``UNUSABLE``: checks pass over it, and code that computes with it stops.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from math import inf, isfinite, pi
from typing import NoReturn

from aerial_gym.errors import ConfigError

MAX_COUNT = 2**31 - 1  # Kernels count with 32 bits
MAX_MADE = 10**6  # Things that are made one by one, such as shapes and rows of obstacles of one environment
LARGEST_SINGLE = (2.0 - 2.0**-23) * 2.0**127  # The largest number of single precision, in which tasks count

Vec3 = tuple[float, float, float]
NO_SOURCE = "no source"  # Source of numbers whose file names none

_faults: ContextVar[list[str] | None] = ContextVar("faults", default=None)


class UnusableValueError(Exception):
    """A check has computed with a value that another check refuses."""


class UnusableValue:
    """Replacement for a missing or refused value."""

    def _stop(self, *_: object) -> NoReturn:
        raise UnusableValueError

    __bool__ = __eq__ = __lt__ = __le__ = __gt__ = __ge__ = __iter__ = __len__ = __contains__ = __getitem__ = _stop
    __repr__ = __abs__ = __neg__ = __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __float__ = (
        __getattr__
    ) = _stop
    __hash__ = object.__hash__


UNUSABLE = UnusableValue()


@contextmanager
def collect_faults() -> Iterator[list[str]]:
    """Yield a list to which checks append the sentences of their faults, in place of an error at the first."""
    faults: list[str] = []
    token = _faults.set(faults)
    try:
        yield faults
    finally:
        _faults.reset(token)


def refuse(sentence: str) -> None:
    """Raise ``ConfigError`` with a sentence, or append it to the faults of the file that is being read."""
    faults = _faults.get()
    if faults is None:
        raise ConfigError(sentence)
    faults.append(sentence)


def require(config: object, name: str, holds: bool, rule: str) -> None:
    """Raise ``ConfigError`` with a field, its value and the rule unless the rule holds."""
    value = getattr(config, name)
    if holds or value is UNUSABLE:
        return
    refuse(f"{type(config).__name__}.{name} = {value!r}: {rule}")
    vars(config)[name] = UNUSABLE  # only while faults are collected


def _usable(config: object, names: Collection[str]) -> Iterator[str]:
    """Yield the names of fields whose values can be checked."""
    return (name for name in names if getattr(config, name) is not UNUSABLE)


def require_choice(config: object, name: str, known: Collection[str]) -> None:
    """Raise ``ConfigError`` unless a field has one of the known values."""
    for field in _usable(config, (name,)):
        require(config, field, getattr(config, field) in known, f"must be one of {', '.join(known)}")


def require_positive(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers are finite and > 0, or None (NaN fails)."""
    for name in _usable(config, names):
        value = getattr(config, name)
        require(config, name, value is None or 0.0 < value < inf, "must be > 0 and finite")


def require_not_negative(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers, or tuples of numbers, are finite and >= 0, or None (NaN fails)."""
    for name in _usable(config, names):
        holds = all(0.0 <= number < inf for number in _numbers(getattr(config, name)))
        require(config, name, holds, "must be >= 0 and finite")


def require_finite(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers or nested tuples of numbers are finite, or None."""
    for name in _usable(config, names):
        require(config, name, all(map(isfinite, _numbers(getattr(config, name)))), "must be finite")


def require_float32(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named numbers are finite in single precision (NaN fails as well)."""
    for name in _usable(config, names):
        holds = abs(getattr(config, name)) <= LARGEST_SINGLE
        require(config, name, holds, f"must be finite, and at most {LARGEST_SINGLE:.2g} either way")


def require_count(config: object, *names: str, most: int = MAX_COUNT) -> None:
    """Raise ``ConfigError`` unless the named whole numbers are from 1 to ``most``."""
    for name in _usable(config, names):
        require(config, name, 1 <= getattr(config, name) <= most, f"must be >= 1 and at most {most:,}")


def require_ordered(config: object, low: str, high: str) -> None:
    """Raise ``ConfigError`` unless every entry of field ``low`` is at most its partner in field ``high``."""
    a, b = list(_numbers(getattr(config, low))), list(_numbers(getattr(config, high)))
    if not all(x <= y for x, y in zip(a, b, strict=True)):
        refuse(f"{type(config).__name__}: {low} = {a} must not exceed {high} = {b}")


def require_ranges(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the fields ``NAME_low`` and ``NAME_high`` of each name are finite and in order."""
    for name in names:
        require_finite(config, f"{name}_low", f"{name}_high")
        require_ordered(config, f"{name}_low", f"{name}_high")


def require_angles(config: object, *names: str) -> None:
    """Raise ``ConfigError`` unless the named tuples of angles are finite and within +-2 pi, or None."""
    require_finite(config, *names)
    for name in _usable(config, names):
        holds = all(abs(angle) <= 2.0 * pi for angle in getattr(config, name) or ())
        require(config, name, holds, "must lie within +-2 pi. Angles are in radians")


def require_inertia(config: object, *, may_vanish: bool = False) -> None:
    """Raise ``ConfigError`` unless ``inertia`` is that of a body; ``may_vanish`` allows moments of 0, as of a point."""
    import numpy as np

    require_finite(config, "inertia")
    matrix = np.asarray(config.inertia, dtype=float)  # type: ignore[attr-defined]
    largest = max(float(np.abs(matrix).max()), 1e-30)
    require(config, "inertia", np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-9 * largest), "must be symmetric")
    low, middle, high = np.linalg.eigvalsh(matrix).tolist()
    holds = low >= -1e-12 if may_vanish else low > 0.0
    require(config, "inertia", holds, f"principal moments must be {'>=' if may_vanish else '>'} 0")
    holds = high <= (low + middle) * (1.0 + (1e-6 if may_vanish else 1e-9))
    rule = f"principal moments {[low, middle, high]} violate the triangle inequality; none may exceed the sum of the others"
    require(
        config,
        "inertia",
        holds,
        f"{rule}. No body is like that: check digits and units, and that it is of the whole body",
    )


def _numbers(value: object) -> Iterator[float]:
    """Yield the numbers of a number or of nested tuples; none of None."""
    if isinstance(value, (tuple, list)):
        for item in value:
            yield from _numbers(item)
    elif value is not None:
        yield float(value)  # type: ignore[arg-type]
