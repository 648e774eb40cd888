"""Decode the messages of one ROS topic at once: messages with strings and sequences of equal lengths have one layout.

Letters: T messages, B bytes.

Source: ROS wiki, *ROS serialization*; OMG DDS-XTypes 1.3, section 7.4, for CDR, the layout of ROS 2.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aerial_gym.sim2real.arrays import Array

NUMBERS = {
    **{"bool": "u1", "byte": "u1", "octet": "u1", "char": "u1", "float32": "<f4", "float64": "<f8"},
    **{f"{sign}int{8 * size}": f"<{kind}{size}" for sign, kind in (("", "i"), ("u", "u")) for size in (1, 2, 4, 8)},
}
"""NumPy type of each number."""

LONGEST_SEQUENCE = 64  # A longer sequence, such as an image, becomes no columns
MOST_COLUMNS, MOST_NODES, MOST_LAYOUTS, DEEPEST = 1000, 4000, 64, 12
Fields = Mapping[str, Any]  # Fields by type, as rosbags states them: (constants, [(name, (node, detail)), ...])


class LayoutError(ValueError):
    """A message does not fit its definition."""


class MessageLayout:
    """Places of the numbers in one message, and of the lengths that determine these places."""

    def __init__(self, data: bytes, kind: str, fields: Fields, *, is_cdr: bool) -> None:
        """Walk through a message; raise ``LayoutError`` if it does not fit the definition of its type."""
        self.numbers: dict[str, tuple[int, np.dtype[Any]]] = {}
        self.lengths: list[int] = []
        self._data, self._fields, self._place, self._open = data, fields, 0, True
        self._origin, self._nodes = 4 if is_cdr else 0, 0
        self._aligned = is_cdr
        if is_cdr:
            if len(data) < 4 or data[1] != 1:  # little endian, version 1
                raise LayoutError("unknown representation")
            self._place = 4
        self._walk_type(kind, "", 0)

    def _align(self, size: int) -> None:
        if self._aligned:
            self._place += -(self._place - self._origin) % size

    def _read_length(self) -> int:
        self._align(4)
        self.lengths.append(self._place)
        value = int.from_bytes(self._data[self._place : self._place + 4], "little")
        self._advance(4)
        return value

    def _advance(self, size: int) -> None:
        self._place += size
        if self._place > len(self._data):
            raise LayoutError("ends too early")

    def _walk_type(self, kind: str, prefix: str, depth: int) -> None:
        if kind not in self._fields or depth > DEEPEST:
            raise LayoutError(f"unknown type {kind}")
        for name, node in self._fields[kind][1]:
            if self._open:
                self._walk_node(node, f"{prefix}.{name}" if prefix else name, depth)

    def _walk_node(self, node: Any, name: str, depth: int) -> None:
        kind, detail = int(node[0]), node[1]
        self._nodes += 1
        if self._nodes > MOST_NODES:
            raise LayoutError("has too many fields")
        if kind == 1:
            self._walk_base(detail[0], name)
        elif kind == 2:
            self._walk_type(detail, name, depth + 1)
        else:
            count = int(detail[1]) if kind == 3 else self._read_length()
            self._walk_items(detail[0], count, name, depth)

    def _walk_items(self, node: Any, count: int, name: str, depth: int) -> None:
        base = int(node[0]) == 1 and node[1][0] in NUMBERS
        if count > LONGEST_SEQUENCE and base:
            size = np.dtype(NUMBERS[node[1][0]]).itemsize
            self._align(size)
            self._advance(size * count)
        elif count > LONGEST_SEQUENCE or len(self.numbers) > MOST_COLUMNS:
            self._open = False  # the fields behind are left out
        else:
            for index in range(count):
                if self._open:
                    self._walk_node(node, f"{name}[{index}]", depth)

    def _walk_base(self, kind: str, name: str) -> None:
        if kind == "string":
            self._advance(self._read_length())
        elif kind in NUMBERS:
            number = np.dtype(NUMBERS[kind])
            self._align(number.itemsize)
            self.numbers[name] = (self._place, number)
            self._advance(number.itemsize)
        else:
            raise LayoutError(f"unknown type {kind}")


def decode_messages(
    messages: Sequence[bytes], kind: str, fields: Fields, *, is_cdr: bool
) -> tuple[dict[str, Array], int]:
    """Return the numbers of all messages by field, NaN where a message lacks one, and the number of undecoded messages."""
    columns: dict[str, Array] = {}
    sizes = np.array([len(message) for message in messages])
    left = np.ones(sizes.size, dtype=bool)
    layouts, lost = 0, 0
    while left.any() and layouts < MOST_LAYOUTS:
        first = int(np.argmax(left))
        rows = np.flatnonzero(left & (sizes == sizes[first]))
        table = np.frombuffer(b"".join(messages[i] for i in rows), dtype=np.uint8).reshape(rows.size, -1)
        layouts += 1
        try:
            layout = MessageLayout(messages[first], kind, fields, is_cdr=is_cdr)
        except LayoutError:
            left[first], lost = False, lost + 1
            continue
        same = np.ones(rows.size, dtype=bool)
        for place in layout.lengths:
            same &= np.all(table[:, place : place + 4] == table[0, place : place + 4], axis=1)
        rows, table = rows[same], table[same]
        for name, (place, number) in layout.numbers.items():
            values = np.ascontiguousarray(table[:, place : place + number.itemsize]).view(number)[:, 0]
            columns.setdefault(name, np.full(sizes.size, np.nan))[rows] = values
        left[rows] = False
    return columns, lost + int(left.sum())
