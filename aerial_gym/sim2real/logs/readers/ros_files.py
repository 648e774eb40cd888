"""Messages in the files of ROS: bags of ROS 1, SQLite databases of ROS 2, and MCAP. Damaged chunks end the search.

No chunk may grow beyond what the file can hold, so that a few bytes do not fill the memory.

Source: ROS wiki, *Bags/Format/2.0*; MCAP specification (mcap.dev/spec); rosbag2 documentation, schema of its SQLite storage.
"""

import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from aerial_gym.errors import DataError, MissingDependencyError
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
        try:
            result = _load_decompressor(method).decompress(data, max_length=self._left + 1)
        except (ImportError, DataError):
            raise
        except Exception as error:  # each library has its own type
            raise DataError(f"{self._path}: a chunk cannot be decompressed ({type(error).__name__})") from None
        self._left -= len(result)
        if self._left < 0:
            raise DataError(f"{self._path}: its chunks grow to more than {MOST_GROWTH} times the file; it is no log")
        return result


def _load_decompressor(method: str) -> Any:
    module, name = DECOMPRESSORS[method]
    try:
        return getattr(import_module(module), name)()
    except ImportError:
        raise MissingDependencyError(
            f"reading chunks in {method} needs rosbags: pip install 'aerial-gym[logs]'"
        ) from None


def read_sources(path: Path) -> list[MessageSource]:
    """Return the messages of a file or of the folder of a ROS 2 bag, by topic, in the order of their times.

    A topic may come from several files, and from several connections, as of a node that started anew.
    """
    sources: dict[tuple[str, ...], MessageSource] = {}
    for one in _folder_sources(path) if path.is_dir() else _file_sources(path):
        same = sources.setdefault((one.topic, one.type, one.definition, one.encoding), one)
        if same is not one:
            order = sorted(
                zip(same.times + one.times, same.messages + one.messages, strict=True), key=lambda row: row[0]
            )
            same.times, same.messages = [time for time, _ in order], [message for _, message in order]
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
    fields, place = {}, 0
    while place + 4 <= len(header):
        size = int.from_bytes(header[place : place + 4], "little")
        name, _, value = header[place + 4 : place + 4 + size].partition(b"=")
        fields[name] = value
        place += 4 + size
    return fields


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
                (name, _, text), _ = _mcap_texts(content, 2, 3)
                schemas.setdefault(int.from_bytes(content[:2], "little"), (name, text))
            elif kind == CHANNEL:
                (topic, encoding), _ = _mcap_texts(content, 4, 2)
                name, text = schemas.get(int.from_bytes(content[2:4], "little"), ("", ""))
                name = name if "/msg/" in name else name.replace("/", "/msg/", 1)
                number = int.from_bytes(content[:2], "little")
                sources.setdefault(number, MessageSource(topic, name, text, encoding))
            elif kind == MCAP_CHUNK and depth == 0:
                (method,), start = _mcap_texts(content, 28, 1)
                read_records(inflater.inflate(content[start + 8 :], method), 0, 1)

    read_records(path.read_bytes(), len(MCAP), 0)
    return list(sources.values())


def _mcap_texts(content: bytes, place: int, count: int) -> tuple[list[str], int]:
    """Return texts, each behind its length in four bytes, and the place behind them."""
    texts = []
    for _ in range(count):
        size = int.from_bytes(content[place : place + 4], "little")
        texts.append(content[place + 4 : place + 4 + size].decode("utf-8", "replace"))
        place += 4 + size
    return texts, place
