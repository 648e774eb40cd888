"""Parse lines of CSV files with varying separators, quotes, comments and malformed lines."""

import csv
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from aerial_gym.errors import DataError

SEPARATORS = (";", "\t", ",")  # Field separators; a header with none of them is separated by spaces
SPACES = " "  # Separator mark for any run of white space
ENCODINGS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # Encodings by byte-order mark; other files are UTF-8
FOREIGN = {
    b"\x1f\x8b": "packed by gzip; unpack it first",
    b"PK\x03\x04": "packed by zip; unpack it first",
    b"BZh": "packed by bzip2; unpack it first",
    b"\xfd7zXZ": "packed by xz; unpack it first",
    b"\x28\xb5\x2f\xfd": "packed by zstd; unpack it first",
    b"7z\xbc": "packed by 7z; unpack it first",
    b"ULogEnc": "encrypted by PX4; decrypt it with your private key",
    b"MATLAB ": "a MATLAB file; export its variables as CSV, one column each",
    b"\x89HDF": "an HDF5 file; export its data as CSV, one column each",
    b"PAR1": "a single Parquet file; give the folder that log convert wrote, or export CSV",
    b"\xfd": "MAVLink without times of reception; record a telemetry log (.tlog)",
}
"""Files that are no logs, by their first bytes, and the way out."""
REMARK = re.compile(r"\s*(#|//|%|sep=|$)", re.IGNORECASE)  # Start of a comment, a separator hint or an empty line
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")  # A number with a decimal comma


@dataclass(frozen=True, kw_only=True)
class CsvHeader:
    """Column names and separator of a CSV file."""

    names: tuple[str, ...]
    separator: str

    def comma_separated_line(self, line: str) -> str | None:
        """Return the line with commas between fields and decimal points; None if the number of fields differs."""
        commas = len(self.names) - 1
        if '"' in line or self.separator == SPACES:
            fields = split_fields(line, self.separator)  # other commas than decimal ones become spaces
            line = ",".join(field.replace(",", "." if DECIMAL_COMMA.fullmatch(field) else " ") for field in fields)
        elif self.separator != ",":
            line = line.replace(",", ".").replace(self.separator, ",")
        while line.count(",") > commas and line.rstrip().endswith(","):
            line = line.rstrip()[:-1]  # trailing separator
        return line if line.count(",") == commas and "\0" not in line else None

    def is_remark(self, line: str) -> bool:
        """Return whether a line holds no row: a comment, an empty line or a repeated header."""
        if line[:1] in _STARTS:
            return False
        return bool(REMARK.match(line)) or split_fields(line, self.separator)[: len(self.names)] == list(self.names)


_STARTS = frozenset("0123456789+-.")  # Common first characters of data rows


def split_fields(line: str, separator: str) -> list[str]:
    """Return the fields of a line without quotes and outer spaces; empty for an unclosed quote."""
    if '"' not in line:
        return [field.strip() for field in (line.split() if separator == SPACES else line.split(separator))]
    try:
        row = next(csv.reader([line.strip()], delimiter=separator, skipinitialspace=True, strict=True), [])
    except csv.Error:
        return []
    return [field.strip() for field in row]


def find_header(lines: Iterable[str], time: str) -> CsvHeader | None:
    """Return the header of a CSV file, or None; consume its lines. A comment with the ``time`` column is one, as by numpy."""
    for line in lines:
        header = _parse_header(line.lstrip(" \t#") if REMARK.match(line) else line)
        if header.names and (time in header.names or not REMARK.match(line)):
            return header
    return None


def _parse_header(line: str) -> CsvHeader:
    separator = max(SEPARATORS, key=lambda mark: len(split_fields(line, mark)))
    if len(split_fields(line, separator)) < 2:
        separator = SPACES
    names = split_fields(line, separator)
    while names and not names[-1]:
        names.pop()
    return CsvHeader(names=tuple(names), separator=separator)


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file. Raise ``DataError`` if the file is unreadable or not text."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise DataError(f"{path}: is a folder; give the log files in it. A bag of ROS 2 has a metadata.yaml") from None
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read as text ({error.strerror}); give a CSV file with one header line"
        ) from None
    check_is_text(data, str(path))
    text = data.decode(ENCODINGS.get(data[:2], "utf-8-sig"), errors="replace")
    return re.split(r"\r\n|\n|\r", text)


def check_is_text(data: bytes, path: str) -> None:
    """Raise ``DataError`` if the first bytes of a file are not text."""
    if foreign := next((text for head, text in FOREIGN.items() if data.startswith(head)), None):
        raise DataError(f"{path}: is {foreign}")
    if data[:2] not in ENCODINGS and b"\0" in data.split(b"\n", 1)[0]:
        raise DataError(
            f"{path}: cannot be read as text: it holds binary data of no known log format "
            "(aerial-gym list log-formats), or is damaged at its beginning"
        )
