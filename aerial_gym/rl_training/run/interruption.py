"""Ctrl-C and SIGTERM during a training: both end it as soon as possible, with a checkpoint."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from aerial_gym.rl_training.ranks import ALONE, Ranks

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Whether somebody asked the training to end. A library may swallow the exception; this is remembered.

    All processes end together at a common check: one that ended alone would leave the others waiting.
    """

    def __init__(self, ranks: Ranks = ALONE) -> None:
        self.asked, self._waits, self._ranks = False, False, ranks

    @contextmanager
    def defer(self) -> Iterator[None]:
        """Defer an interruption until the block has ended, then raise it."""
        self._waits = True
        try:
            yield
        finally:
            self._waits = False
        self.check()

    def check(self) -> None:
        """Raise ``KeyboardInterrupt`` if any process got a signal; all processes must call this."""
        self.asked = self._ranks.any(self.asked)
        if self.asked:
            raise KeyboardInterrupt

    def _note_signal(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
        if not (self._waits or self._ranks.joined):
            raise KeyboardInterrupt


@contextmanager
def interruptible(ranks: Ranks = ALONE) -> Iterator[Interruption]:
    """Yield an ``Interruption`` that both signals set, then restore the handlers; only the main thread gets signals."""
    interruption = Interruption(ranks)
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    kept = {number: signal.signal(number, interruption._note_signal) for number in SIGNALS}
    try:
        yield interruption
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
