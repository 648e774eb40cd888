"""Fixtures of tests of physics."""

from collections.abc import Iterator

import pytest

from aerial_gym.interop.launches import one_thread


@pytest.fixture
def single_thread() -> Iterator[None]:
    """Compute small batches without threads, which would only wait for each other."""
    with one_thread():
        yield
