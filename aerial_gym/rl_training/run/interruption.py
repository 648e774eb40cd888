"""Ctrl-C and SIGTERM while a training runs: both end it as soon as may be, and it saves."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interruption:
    """Whether somebody asked the training to end. A library may swallow the exception; this is remembered."""

    def __init__(self) -> None:
        self.asked, self._waits = False, False

    @contextmanager
    def held(self) -> Iterator[None]:
        """Let what is inside end first, as it cannot be left half done; then raise."""
        self._waits = True
        try:
            yield
        finally:
            self._waits = False
        self.check()

    def check(self) -> None:
        """Raise ``KeyboardInterrupt`` if the training was asked to end."""
        if self.asked:
            raise KeyboardInterrupt

    def _ask(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.asked = True
        if not self._waits:
            raise KeyboardInterrupt


@contextmanager
def interruptible() -> Iterator[Interruption]:
    """Give an ``Interruption`` that both signals set, and put the handlers back; another thread than the main one has none."""
    interruption = Interruption()
    if threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    kept = {number: signal.signal(number, interruption._ask) for number in SIGNALS}
    try:
        yield interruption
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
