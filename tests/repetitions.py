"""Which repetitions of a test run always, and which with ``make test-slow`` alone."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def rare_values(values: Iterable[Any], index: Container[Any]) -> list[Any]:
    """Return values as parameters of a test, of which some are tested with ``make test-slow`` alone."""
    return [_parameter(value, slow=value in index) for value in values]


def frequent_values(values: Iterable[Any], index: Container[Any]) -> list[Any]:
    """Return values as parameters of a test, of which all but some are tested with ``make test-slow`` alone."""
    return [_parameter(value, slow=value not in index) for value in values]


def thin_values(values: Iterable[Any], every: int) -> list[Any]:
    """Return values as parameters of a test, of which the first of so many is tested always."""
    return [_parameter(value, slow=number % every > 0) for number, value in enumerate(values)]


def _parameter(value: Any, *, slow: bool) -> Any:
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), marks=pytest.mark.slow if slow else ())
