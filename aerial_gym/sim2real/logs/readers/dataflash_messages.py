"""Messages in DataFlash logs of ArduPilot, binary or as text, as one table for each type.

Source: ArduPilot, ``libraries/AP_Logger/README.md`` and ``LogStructure.h``.
"""

import re
from collections.abc import Hashable
from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.raw_log import read_records, whole_records_in_chain

HEAD = b"\xa3\x95"  # First bytes of each message, before its type
FMT, FMT_LENGTH = 128, 89  # Type and length of the messages that define the others
TYPES: dict[str, tuple[str, float]] = {
    **dict.fromkeys("BM", ("u1", 1.0)),
    **{"b": ("i1", 1.0), "h": ("<i2", 1.0), "H": ("<u2", 1.0), "i": ("<i4", 1.0), "I": ("<u4", 1.0)},
    **{"q": ("<i8", 1.0), "Q": ("<u8", 1.0), "g": ("<f2", 1.0), "f": ("<f4", 1.0), "d": ("<f8", 1.0)},
    **{"c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01), "E": ("<u4", 0.01)},
    **{"L": ("<i4", 1e-7), "a": ("(32,)<i2", 1.0), "n": ("S4", 0.0), "N": ("S16", 0.0), "Z": ("S64", 0.0)},
}
"""NumPy type and unit of each format character; 0 for text."""

TEXT_LOG = re.compile(rb"^FMT, ?\d+, ?\d+, ?\w{1,4}, ?\w{1,16}, ?\w", re.MULTILINE)  # First line of a log as text
IN_TEXT = str.maketrans("MHhIiQqgfcCeEL", "N" + 13 * "d")  # Formats of a log as text, whose numbers need no factor
TIMES = {"TimeUS": 1e-6, "TimeMS": 1e-3}  # Fields of the time and their units [s]
MOST_FIELDS, LONGEST_NUMBER = 16, 40  # Most fields of a message, and most characters of a number in text


@dataclass(frozen=True, kw_only=True)
class MessageType:
    """Definition of one type of message."""

    name: str
    length: int  # [B], with the head
    format: str  # One character per field
    fields: tuple[str, ...]

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Name and format character of each field."""
        return list(zip(self.fields, self.format, strict=False))

    @property
    def record(self) -> np.dtype[Any]:
        """Return the NumPy type of the fields, named by their place; raise ``KeyError`` for an unknown character."""
        return np.dtype([(str(i), TYPES[code][0]) for i, code in enumerate(self.format)])


@dataclass(frozen=True, kw_only=True)
class MessageTable:
    """All messages of one type."""

    type: MessageType
    rows: NDArray[Any]  # With one field for each place, (T,)

    def numbers(self, field: str) -> Array:
        """Return the numbers of a field, (T,); raise ``ValueError`` if the message has no such field of numbers."""
        places = [i for i, (name, code) in enumerate(self.type.columns) if name == field and TYPES[code][1] != 0.0]
        if not places or self.type.format[places[0]] == "a":
            raise ValueError(f"no numbers {field}")
        values, unit = self.rows[str(places[0])].astype(np.float64), TYPES[self.type.format[places[0]]][1]
        return values if unit == 1.0 else values * unit

    def texts(self, field: str) -> list[str]:
        """Return the texts of a field; empty without such a field of text."""
        column = self._column(field)
        return [text.decode("latin-1") for text in column.tolist()] if column.dtype.kind == "S" else []

    @property
    def seconds(self) -> Array:
        """Times [s], (T,); zeros for a message without time."""
        field = next((name for name in TIMES if name in self.type.fields[: len(self.type.format)]), "TimeUS")
        values = self._column(field)
        return values.astype(np.float64) * TIMES[field] if values.dtype.kind in "uif" else np.zeros(self.rows.size)

    def _column(self, field: str) -> NDArray[Any]:
        """Return the raw values of a field; one of the type bool if the messages have no such field."""
        names = self.type.fields[: len(self.type.format)]
        return self.rows[str(names.index(field))] if field in names else np.zeros(1, dtype=bool)


def message_types_in_binary_log(data: NDArray[np.uint8]) -> dict[int, MessageType]:
    """Return the types that FMT messages define, by number. The first definition of a type counts."""
    places = _head_places(data)
    places = places[data[places + 2] == FMT]
    results: dict[int, MessageType] = {}
    for place in places[places + FMT_LENGTH <= data.size].tolist():
        row = data[place + 3 : place + FMT_LENGTH].tobytes()
        name, codes, fields = (part.rstrip(b"\0").decode("latin-1") for part in (row[2:6], row[6:22], row[22:]))
        one = MessageType(name=name, length=row[1], format=codes, fields=tuple(fields.split(",")))
        known = name.isalnum() and codes and set(codes) <= TYPES.keys() and len(one.fields) >= len(codes)
        if known and one.record.itemsize + 3 == one.length:
            results.setdefault(row[0], one)
    return results


def _head_places(data: NDArray[np.uint8]) -> Indices:
    """Return the places of heads that a type follows."""
    places = np.flatnonzero(data[:-2] == HEAD[0])
    return places[data[places + 1] == HEAD[1]]


def tables_of_binary_messages(data: NDArray[np.uint8], types: dict[int, MessageType]) -> tuple[list[MessageTable], int]:
    """Return one table for each type of message, and the number of bytes in all messages.

    A message counts if another one, or the end of the file, follows it; data that look like a head are inside of messages.
    """
    lengths = np.zeros(256, dtype=np.int64)
    lengths[list(types)] = [one.length for one in types.values()]
    places = _head_places(data)
    places = places[lengths[data[places + 2]] > 0]
    numbers = data[places + 2]
    ends = places + lengths[numbers]
    kept = whole_records_in_chain(places, ends, data.size)
    pairs = [(types[number], places[kept & (numbers == number)] + 3) for number in np.unique(numbers[kept]).tolist()]
    tables = [MessageTable(type=one, rows=read_records(data, starts, one.record)) for one, starts in pairs]
    return tables, int((ends - places)[kept].sum())


def read_lines(text: str) -> tuple[dict[int, MessageType], list[MessageTable]]:
    """Return the types of a log as text by number, and one table for each type of message."""
    lines: dict[str, list[str]] = {}
    for line in text.splitlines():
        name, _, rest = line.partition(",")
        lines.setdefault(name, []).append(rest)
    types: dict[int, MessageType] = {}
    for row in lines.get("FMT", ()):
        number, _, name, codes, *rest = (part.strip() for part in (*row.split(","), "", "", "", ""))
        codes, fields = codes.translate(IN_TEXT), tuple(field for field in rest if field)
        known = set(codes) <= TYPES.keys() - {"a"} and 0 < len(codes) <= min(len(fields), MOST_FIELDS)
        if known and number.isdecimal() and int(number) < 256 and name != "FMT":
            types.setdefault(int(number), MessageType(name=name, length=0, format=codes, fields=fields))
    known_types = [one for one in types.values() if one.name in lines]
    return types, [MessageTable(type=one, rows=_parse_lines(one, lines[one.name])) for one in known_types]


def _parse_lines(one: MessageType, lines: list[str]) -> NDArray[Any]:
    """Return the rows of the messages of a type, (T,); what is no number becomes NaN, or 0 where the number is whole."""
    size = len(one.format)
    texts: dict[Hashable, Any] = {place: str for place, code in enumerate(one.format) if TYPES[code][1] == 0.0}
    if size - 1 in texts:  # which may hold commas
        rows = pd.DataFrame([(*line.split(",", size - 1), *size * [""])[:size] for line in lines])
    else:
        source = StringIO("\n".join((lines[0] + "," * size, *lines[1:])))  # pandas refuses a table without full rows
        rows = pd.read_csv(
            source, header=None, names=range(size), usecols=range(size), quoting=3, dtype=texts, low_memory=False
        )
    table = np.zeros(len(rows), dtype=one.record)
    for place in range(size):
        column, kind = rows[place], one.record[str(place)].kind
        if place in texts:
            table[str(place)] = column.fillna("").str.strip().str.encode("latin-1", "replace")
            continue
        if not pd.api.types.is_numeric_dtype(column):
            column = column.astype(str).str.slice(0, LONGEST_NUMBER)
        numbers = np.asarray(pd.to_numeric(column, errors="coerce"), dtype=np.float64)
        table[str(place)] = numbers if kind == "f" else np.clip(np.nan_to_num(numbers), -128, 255).astype(int)
    return table
