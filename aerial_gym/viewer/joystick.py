"""A gamepad of this machine, read from Linux's joystick device; viser has no message for one in the browser.

Source: linux/joystick.h, struct js_event (time u32, value s16, type u8, number u8), 8 bytes.
"""

import os
import struct
from pathlib import Path

EVENT, AXIS, FULL = struct.Struct("IhBB"), 0x02, 32767.0
DEAD = 0.05  # Share of the range around the middle that counts as the middle
STICKS = {1: -1.0, 0: -1.0, 3: -1.0, 4: -1.0}
"""Axes of a gamepad with their sign: left stick up, left; right stick left, up. A pushed stick reads -1 away from the user."""


class Joystick:
    """Axes of the first gamepad; none where there is no such device."""

    def __init__(self, device: str | Path = "/dev/input/js0") -> None:
        self._axes = dict.fromkeys(STICKS, 0.0)
        try:
            self._file: int | None = os.open(device, os.O_RDONLY | os.O_NONBLOCK)
        except OSError:
            self._file = None

    @property
    def is_there(self) -> bool:
        """Whether a gamepad is connected."""
        return self._file is not None

    def axes(self) -> dict[str, float]:
        """Return the sticks, each -1 to 1: ``up`` and ``turn`` of the left one, ``forward`` and ``left`` of the right one."""
        while self._file is not None:
            try:
                events = os.read(self._file, 64 * EVENT.size)
            except BlockingIOError:
                break
            except OSError:  # disconnected
                os.close(self._file)
                self._file, events = None, b""
            if not events:
                break
            for _, value, kind, number in EVENT.iter_unpack(events[: len(events) // EVENT.size * EVENT.size]):
                if kind & AXIS and number in self._axes:
                    share = STICKS[number] * value / FULL
                    self._axes[number] = 0.0 if abs(share) < DEAD else max(-1.0, min(1.0, share))
        return dict(zip(("up", "turn", "left", "forward"), self._axes.values(), strict=True))
