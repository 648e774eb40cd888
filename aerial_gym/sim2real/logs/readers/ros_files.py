"""Messages in the files of ROS, bags of ROS 1, SQLite databases of ROS 2 and MCAP, and the numbers in them.

Damaged chunks end the search. No chunk may grow beyond what the file can hold, so that a few bytes do not fill the memory.
Messages of a topic with strings and sequences of equal lengths have one layout and are decoded at once. Letters: T messages.

Source: ROS wiki, *Bags/Format/2.0* and *ROS serialization*; OMG DDS-XTypes 1.3, section 7.4, for CDR, the layout of ROS 2; MCAP
specification (mcap.dev/spec); rosbag2 documentation, schema of its SQLite storage.
"""

import json
import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.extras import optional_import
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.raw_log import FREE_BYTES, MOST_GROWTH

BAG, DATABASE, MCAP = b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"\x89MCAP0\r\n"  # First bytes
ZSTD = b"\x28\xb5\x2f\xfd"  # First bytes of data in zstd; messages in CDR begin with 0
CHUNK, CONNECTION, MESSAGE = 5, 7, 2  # Records of a ROS 1 bag
SCHEMA, CHANNEL, MCAP_MESSAGE, MCAP_CHUNK = 3, 4, 5, 6  # Records of an MCAP file
STORED_TABLES = "SELECT name FROM sqlite_master WHERE type = 'table' AND sql NOT LIKE '%VIRTUAL%'"
DATABASE_STEPS = 50_000_000  # Most steps of SQLite's machine in one query; a million messages need 10 million


@dataclass
class MessageSource:
    """Messages of one topic and type, as they were stored."""

    topic: str
    type: str  # Such as ``sensor_msgs/msg/Imu``
    definition: str  # Text of the message definition; empty if unknown
    encoding: str  # ``cdr`` (ROS 2), ``ros1``, or another one that is not read, such as ``protobuf``
    times: list[int] = field(default_factory=list)  # Time of the record [ns]
    messages: list[bytes] = field(default_factory=list)


DEEPEST = 8  # Levels of fields in messages of JSON

DECOMPRESSORS = {
    "bz2": ("bz2", "BZ2Decompressor"),
    "lz4": ("lz4.frame", "LZ4FrameDecompressor"),
    "zstd": ("backports.zstd", "ZstdDecompressor"),
}
"""Module and class by the name of a compression."""


class Inflater:
    """Decompression with a limit for the whole file."""

    def __init__(self, path: Path) -> None:
        self._path, self._left = path, MOST_GROWTH * path.stat().st_size + FREE_BYTES

    def inflate(self, data: bytes, method: str) -> bytes:
        """Return the decompressed data; raise ``DataError`` beyond the limit, for damaged data and for unknown methods."""
        if method in ("", "none"):
            return data
        if method not in DECOMPRESSORS:
            raise DataError(f"{self._path}: a chunk has the unknown compression {method[:20]!r}")
        module, name = DECOMPRESSORS[method]
        with optional_import(f"reading chunks in {method}"):
            decompressor = getattr(import_module(module), name)()
        try:
            result = decompressor.decompress(data, max_length=self._left + 1)
        except Exception as error:  # each library has its own type
            raise DataError(f"{self._path}: a chunk cannot be decompressed ({type(error).__name__})") from None
        self._left -= len(result)
        if self._left < 0:
            raise DataError(f"{self._path}: its chunks grow to more than {MOST_GROWTH} times the file; it is no log")
        return result


def read_message_sources(path: Path) -> list[MessageSource]:
    """Return the messages of a file or of the folder of a ROS 2 bag, by topic, in the order of their times.

    A topic may come from several files, and from several connections, as of a node that started anew.
    """
    sources: dict[tuple[str, ...], MessageSource] = {}
    for one in _folder_sources(path) if path.is_dir() else _file_sources(path):
        same = sources.setdefault((one.topic, one.type, one.definition, one.encoding), one)
        if same is not one:
            pairs = zip(same.times + one.times, same.messages + one.messages, strict=True)
            same.times, same.messages = map(list, zip(*sorted(pairs, key=lambda pair: pair[0]), strict=True))
    return list(sources.values())


def _folder_sources(path: Path) -> Iterator[MessageSource]:
    """Yield the messages of all files of a ROS 2 bag, which may be packed one by one."""
    files = sorted(file for file in path.iterdir() if set(file.suffixes) & {".db3", ".mcap"})
    if not files:
        raise DataError(f"{path}: the folder holds no file .db3 or .mcap")
    for file in files:
        with file.open("rb") as stream:
            is_packed = stream.read(len(ZSTD)) == ZSTD
        if not is_packed:
            yield from _file_sources(file)
            continue
        with TemporaryDirectory() as folder:
            unpacked = Path(folder, file.name)
            unpacked.write_bytes(Inflater(file).inflate(file.read_bytes(), "zstd"))
            yield from _file_sources(unpacked)


def _file_sources(path: Path) -> list[MessageSource]:
    """Return the messages of one file; those that are packed one by one are unpacked."""
    with path.open("rb") as stream:
        head = stream.read(len(DATABASE))
    readers: dict[bytes, Callable[[Path], list[MessageSource]]] = {
        BAG: _read_bag,
        DATABASE: _read_database,
        MCAP: _read_mcap,
    }
    reader = next((one for mark, one in readers.items() if head.startswith(mark)), None)
    if reader is None:
        raise DataError(f"{path}: is no bag of version 2.0, no SQLite database and no MCAP; convert it (rosbag fix)")
    sources, inflater = [source for source in reader(path) if source.messages], Inflater(path)
    for source in sources:
        if source.encoding == "cdr" and source.messages[0].startswith(ZSTD):
            source.messages = [inflater.inflate(message, "zstd") for message in source.messages]
    return sources


def _bag_records(data: bytes, place: int) -> Iterator[tuple[dict[bytes, bytes], bytes]]:
    """Yield header and content of the records of a ROS 1 bag, up to a damaged one."""
    while place + 8 <= len(data):
        size = int.from_bytes(data[place : place + 4], "little")
        end = place + 4 + size
        if end + 4 > len(data):
            return
        length = int.from_bytes(data[end : end + 4], "little")
        header = _bag_fields(data[place + 4 : end])
        if end + 4 + length > len(data) and header.get(b"op") != bytes([CHUNK]):
            return  # of a chunk the recording may have ended within
        yield header, data[end + 4 : end + 4 + length]
        place = end + 4 + length


def _bag_fields(header: bytes) -> dict[bytes, bytes]:
    """Return the values of a header of a ROS 1 record by name."""
    parts = (part.partition(b"=") for part in _parts_with_length(header, 0)[0])
    return {name: value for name, _, value in parts}


def _parts_with_length(data: bytes, place: int, count: int | None = None) -> tuple[list[bytes], int]:
    """Return ``count`` parts, or all, each behind its length in four bytes, and the place behind them."""
    parts = list[bytes]()
    while len(parts) != count and (count is not None or place + 4 <= len(data)):
        size = int.from_bytes(data[place : place + 4], "little")
        parts.append(data[place + 4 : place + 4 + size])
        place += 4 + size
    return parts, place


def _read_bag(path: Path) -> list[MessageSource]:
    """Return the messages of a ROS 1 bag; its index is not needed, so that an unfinished bag is read as well."""
    sources: dict[bytes, MessageSource] = {}
    inflater = Inflater(path)

    def read_records(data: bytes, place: int, depth: int) -> None:
        for header, content in _bag_records(data, place):
            kind = header.get(b"op", b"\0")[:1]
            if kind == bytes([MESSAGE]):
                source, time = sources.get(header.get(b"conn", b"")), header.get(b"time", b"")
                if source is not None and len(time) == 8:
                    seconds, nanoseconds = struct.unpack("<II", time)
                    source.times.append(1_000_000_000 * seconds + nanoseconds)
                    source.messages.append(content)
            elif kind == bytes([CONNECTION]):
                texts = {key: value.decode("utf-8", "replace") for key, value in _bag_fields(content).items()}
                name = texts.get(b"type", "").replace("/", "/msg/", 1)
                topic = header.get(b"topic", b"").decode("utf-8", "replace")
                source = MessageSource(topic, name, texts.get(b"message_definition", ""), "ros1")
                sources.setdefault(header.get(b"conn", b""), source)
            elif kind == bytes([CHUNK]) and depth == 0:
                method = header.get(b"compression", b"none").decode("latin-1")
                read_records(inflater.inflate(content, method), 0, 1)

    read_records(path.read_bytes(), len(BAG), 0)
    return list(sources.values())


def _read_database(path: Path) -> list[MessageSource]:
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
            steps = iter(range(DATABASE_STEPS // 100_000))
            base.set_progress_handler(lambda: next(steps, None) is None, 100_000)
            tables = {name for (name,) in base.execute(STORED_TABLES)}
            if not {"topics", "messages"} <= tables:
                raise DataError(f"{path}: is a SQLite database, but no bag of ROS 2")
            texts = {}
            if "message_definitions" in tables:
                texts = dict(base.execute("SELECT topic_type, encoded_message_definition FROM message_definitions"))
            sources = {
                number: MessageSource(str(name), str(kind), str(texts.get(kind, "")), "cdr")
                for number, name, kind in base.execute("SELECT id, name, type FROM topics")
            }
            for number, time, data in base.execute("SELECT topic_id, timestamp, data FROM messages"):
                if number in sources and isinstance(data, bytes) and isinstance(time, int):
                    sources[number].times.append(time)
                    sources[number].messages.append(data)
    except (sqlite3.Error, UnicodeError, OverflowError) as error:
        raise DataError(f"{path}: the database of the bag is damaged ({type(error).__name__})") from None
    return list(sources.values())


def _read_mcap(path: Path) -> list[MessageSource]:
    schemas: dict[int, tuple[str, str]] = {}
    sources: dict[int, MessageSource] = {}
    inflater = Inflater(path)

    def read_records(data: bytes, place: int, depth: int) -> None:
        while place + 9 <= len(data):
            kind, size = data[place], int.from_bytes(data[place + 1 : place + 9], "little")
            content = data[place + 9 : place + 9 + size]
            place += 9 + size
            if len(content) < size and kind != MCAP_CHUNK:
                return  # of a chunk the recording may have ended within
            if kind == MCAP_MESSAGE and size >= 22:
                source = sources.get(int.from_bytes(content[:2], "little"))
                if source is not None:
                    source.times.append(int.from_bytes(content[6:14], "little"))
                    source.messages.append(content[22:])
            elif kind == SCHEMA:
                name, _, text = (part.decode("utf-8", "replace") for part in _parts_with_length(content, 2, 3)[0])
                schemas.setdefault(int.from_bytes(content[:2], "little"), (name, text))
            elif kind == CHANNEL:
                topic, encoding = (part.decode("utf-8", "replace") for part in _parts_with_length(content, 4, 2)[0])
                name, text = schemas.get(int.from_bytes(content[2:4], "little"), ("", ""))
                name = name if "/msg/" in name else name.replace("/", "/msg/", 1)
                number = int.from_bytes(content[:2], "little")
                sources.setdefault(number, MessageSource(topic, name, text, encoding))
            elif kind == MCAP_CHUNK and depth == 0:
                (method,), start = _parts_with_length(content, 28, 1)
                read_records(inflater.inflate(content[start + 8 :], method.decode("utf-8", "replace")), 0, 1)

    read_records(path.read_bytes(), len(MCAP), 0)
    return list(sources.values())


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
    """Places of the numbers in one message, its texts, and places of the lengths that determine these places."""

    def __init__(self, data: bytes, kind: str, fields: Fields, *, is_cdr: bool) -> None:
        """Walk through a message; raise ``LayoutError`` if it does not fit the definition of its type."""
        self.numbers: dict[str, tuple[int, np.dtype[Any]]] = {}
        self.texts: dict[str, bytes] = {}
        self.lengths: list[int] = []
        self._data, self._fields, self._place, self._open = data, fields, 0, True
        self._origin, self._nodes = 4 if is_cdr else 0, 0
        self._aligned = is_cdr
        if is_cdr:
            if len(data) < 4 or data[1] != 1:  # little endian, version 1
                raise LayoutError("unknown representation")
            self._place = 4
        self._walk_type(kind, "", 0)

    def _align_to_size(self, size: int) -> None:
        if self._aligned:
            self._place += -(self._place - self._origin) % size

    def _read_length(self) -> int:
        self._align_to_size(4)
        self.lengths.append(self._place)
        value = int.from_bytes(self._data[self._place : self._place + 4], "little")
        self._skip_bytes(4)
        return value

    def _skip_bytes(self, size: int) -> None:
        self._place += size
        if self._place > len(self._data):
            raise LayoutError("ends too early")

    def _walk_type(self, kind: str, prefix: str, depth: int) -> None:
        if kind not in self._fields or depth > DEEPEST:
            raise LayoutError(f"unknown type {kind}")
        for name, node in self._fields[kind][1]:
            if self._open:
                self._walk_field(node, f"{prefix}.{name}" if prefix else name, depth)

    def _walk_field(self, node: Any, name: str, depth: int) -> None:
        kind, detail = int(node[0]), node[1]
        self._nodes += 1
        if self._nodes > MOST_NODES:
            raise LayoutError("has too many fields")
        if kind == 1:
            self._walk_number_or_text(detail[0], name)
        elif kind == 2:
            self._walk_type(detail, name, depth + 1)
        else:
            count = int(detail[1]) if kind == 3 else self._read_length()
            self._walk_array(detail[0], count, name, depth)

    def _walk_array(self, node: Any, count: int, name: str, depth: int) -> None:
        base = int(node[0]) == 1 and node[1][0] in NUMBERS
        if count > LONGEST_SEQUENCE and base:
            size = np.dtype(NUMBERS[node[1][0]]).itemsize
            self._align_to_size(size)
            self._skip_bytes(size * count)
        elif count > LONGEST_SEQUENCE or len(self.numbers) > MOST_COLUMNS:
            self._open = False  # the fields behind are left out
        else:
            for index in range(count):
                if self._open:
                    self._walk_field(node, f"{name}[{index}]", depth)

    def _walk_number_or_text(self, kind: str, name: str) -> None:
        if kind == "string":
            size, start = self._read_length(), self._place
            self._skip_bytes(size)
            self.texts[name] = self._data[start : start + size].rstrip(b"\0")
        elif kind in NUMBERS:
            number = np.dtype(NUMBERS[kind])
            self._align_to_size(number.itemsize)
            self.numbers[name] = (self._place, number)
            self._skip_bytes(number.itemsize)
        else:
            raise LayoutError(f"unknown type {kind}")


def json_columns(messages: Sequence[bytes]) -> dict[str, Array]:
    """Return the numbers of messages in JSON by field, such as ``pose.position.x``; raise ``ValueError`` for other text."""
    table = pd.json_normalize(json.loads(b"[" + b",".join(messages) + b"]"), max_level=DEEPEST)
    empty = [name for name in table.columns if bool(table[name].isna().all())]
    table[empty] = np.nan
    return {str(name): table[name].to_numpy() for name in table.columns if pd.api.types.is_numeric_dtype(table[name])}


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
