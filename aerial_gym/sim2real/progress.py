"""How a run tells what it is doing."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Told what is being done and which share of the work is done."""


def silent(stage: str, share: float) -> None:
    """Report no progress."""
    del stage, share
