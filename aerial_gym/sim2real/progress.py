"""Progress reports of a run."""

from collections.abc import Callable

Progress = Callable[[str, float], None]  # Called with the current stage and the completed share of the work


def silent(stage: str, share: float) -> None:
    """Report no progress."""
    del stage, share
