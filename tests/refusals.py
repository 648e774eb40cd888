"""Check that a wrong request is refused."""

from collections.abc import Callable

import pytest


def assert_refused(
    error: type[Exception], message: str, call: Callable[..., object], *args: object, **given: object
) -> None:
    """Check that a call raises an error whose message contains a pattern."""
    with pytest.raises(error, match=message):
        call(*args, **given)
