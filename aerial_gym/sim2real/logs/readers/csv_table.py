"""Columns of a CSV file as numbers, and what is wrong with a file, told with its line and the way out.

Letters: T rows.
"""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.mapping import HEIGHTS, UNITS, ColumnsCfg, LogMapping, find_mapping, mapping_names
from aerial_gym.sim2real.logs.recording import HEADER_LINES

FEW_DIGITS = 20
"""If time stands still in more than one row of so many, it was written with too few digits."""


def read_table(path: Path, layout: LogMapping) -> pd.DataFrame:
    """Return the file as text and numbers: empty fields are NaN, and only they."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise DataError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text ({error}); give a CSV file with one header line") from None
    lines = text.rstrip().splitlines()
    if len(lines) < 2:
        raise DataError(f"{path}: holds no rows; a flight log has one header line and one line per sample")
    width = lines[0].count(",")
    for mark, name in ((";", "';'"), ("\t", "tabs"), (" ", "spaces")):
        if width == 0 and lines[0].strip().count(mark) > 1:
            raise DataError(f"{path}: fields are separated by {name}; separate them by ','")
    for number, line in enumerate(lines, start=1):
        if line.count(",") != width:
            fields = line.count(",") + 1
            raise DataError(
                f"{path}, line {number}: has {fields} fields, the header has {width + 1}; "
                "remove the line if the log was cut off there"
            )
    names = [name.strip() for name in lines[0].split(",")]
    wanted = {name for q in layout.quantities().values() for name in _names(q, names)}
    twice = sorted(name for name in wanted if names.count(name) > 1)
    if twice:
        raise DataError(f"{path}: column {twice[0]!r} appears twice in the header; rename or remove one of them")
    try:
        table = pd.read_csv(
            path,
            encoding="utf-8-sig",
            keep_default_na=False,
            na_values=[""],
            skipinitialspace=True,
            float_precision="round_trip",
        )
    except (ValueError, OverflowError) as error:  # an unbalanced quote, a field that is no text
        raise DataError(f"{path}: cannot be read as CSV ({' '.join(str(error).split())})") from None
    if len(table.columns) != len(names):
        raise DataError(f"{path}: the header has {len(names)} fields, pandas finds {len(table.columns)}; remove quotes")
    table.columns = names
    return table


def _names(quantity: ColumnsCfg, known: Sequence[str]) -> list[str]:
    """Return the column names of a quantity, with ``{n}`` counted up as far as the file goes."""
    pattern, found = "".join(quantity.columns[:1]), []
    if len(quantity.columns) > 1 or "{n}" not in pattern:
        return list(quantity.columns)
    while (name := pattern.replace("{n}", str(len(found) + 1))) in known:
        found.append(name)
    return found


def columns_of(table: pd.DataFrame, quantity: ColumnsCfg, name: str, path: str) -> list[str]:
    """Return the columns of a quantity; none if the file has none of them, or only empty ones."""
    names = _names(quantity, list(table.columns))
    present = [column for column in names if column in table.columns and not bool(table[column].isna().all())]
    missing = [column for column in names if column not in present]
    if present and missing:
        raise DataError(
            f"{path}: column {missing[0]!r} is missing or empty while {present[0]!r} is there; "
            f"add it, or remove every column of {name}"
        )
    return present


def without_copies(table: pd.DataFrame, notes: list[str]) -> pd.DataFrame:
    """Return the table without rows that are the same as the one before in every column, time included."""
    copies = np.arange(len(table)) > 0
    for _, column in table.items():
        before = column.shift()
        copies &= np.asarray((column == before) | (column.isna() & before.isna()))
        if not copies.any():
            return table
    notes.append(f"{int(copies.sum())} rows that are copies of the one before, time included, were left out")
    return table.drop(index=table.index[copies])


def time_of(table: pd.DataFrame, layout: LogMapping, path: str) -> Array:
    """Return the time [s]; refuse a missing column and time that stands still or runs back."""
    column = layout.time.columns[0]
    time = column_in(table, column, path) * UNITS[layout.time.unit]
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size * FEW_DIGITS > time.size and np.all(np.diff(time) >= 0.0):
        raise DataError(
            f"{path}: {column} is the same in {back.size} rows as in the row before; it has too few digits to tell rows apart: "
            "write it with more, counted from the start of the flight"
        )
    if back.size:
        row = int(back[0]) + 1
        raise DataError(
            f"{path}, line {row + 1 + HEADER_LINES}: {column} = {time[row]:.6g} s does not increase "
            f"(row before: {time[row - 1]:.6g} s); sort the rows and remove repeated ones"
        )
    return time


def column_in(table: pd.DataFrame, column: str, path: str) -> Array:
    """Return a column (T,) that must be there, and without a gap."""
    if column not in table.columns:
        raise DataError(not_there(column, list(table.columns), path))
    return numbers_in(table, [column], ColumnsCfg(columns=(column,)), np.zeros(len(table)), path, [])[:, 0]


def numbers_in(
    table: pd.DataFrame,
    columns: list[str],
    quantity: ColumnsCfg,
    time: Array,
    path: str,
    notes: list[str],
    *,
    gaps: bool = False,
    held: bool = False,
) -> Array:
    """Return numbers (T, columns) with short gaps filled where the mapping allows it.

    ``gaps``: they may stay NaN; ``held``: a number holds until the next one.
    """
    found, filled = np.empty((len(table), len(columns))), 0
    for index, column in enumerate(columns):
        numbers = np.asarray(pd.to_numeric(table[column], errors="coerce"), dtype=np.float64)
        bad = np.flatnonzero(np.asarray(table[column].notna()) & ~np.isfinite(numbers))
        if bad.size:
            raise DataError(
                f"{path}, line {bad[0] + 1 + HEADER_LINES}: {column} = {table[column].iloc[bad[0]]!s} is no finite "
                "number; cut the flight there, or leave the whole column empty if it was not measured"
            )
        if gaps:
            found[:, index] = numbers
            continue
        found[:, index] = _fill(numbers, quantity, time, f"{path}, line {{line}}: {column}", held=held)
        filled += int(np.isnan(numbers).sum())
    if filled:
        how = "by the value before" if held else "by straight lines"
        notes.append(f"{filled} empty fields of {columns[0]} to {columns[-1]} filled {how}")
    return found


def _fill(numbers: Array, quantity: ColumnsCfg, time: Array, where: str, *, held: bool) -> Array:
    """Return ``numbers`` without NaN: short runs become straight lines, or the value before; long ones are refused."""
    empty = np.isnan(numbers)
    if not empty.any():
        return numbers
    edges = np.flatnonzero(np.diff(np.concatenate(([0], empty.astype(int), [0]))))
    full_time = np.concatenate(([time[0]], time, [time[-1]]))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        gap = float(full_time[stop + 1] - full_time[start])
        if gap > quantity.fill_gap_s or quantity.fill_gap_s == 0.0:
            raise DataError(
                where.format(line=start + 1 + HEADER_LINES)
                + f" is empty (NaN) for {stop - start} rows while other rows have it; cut the flight there, fill the gap, "
                "or let a mapping file allow it (fill_gap_s)"
            )
    known = np.flatnonzero(~empty)
    if held:
        return numbers[known[np.maximum(np.searchsorted(known, np.arange(time.size), side="right") - 1, 0)]]
    return np.interp(time, time[known], numbers[known])


def not_there(column: str, known: list[str], path: str) -> str:
    """Return what is said of a column that a file lacks, with the nearest of those that it has and the way out."""
    near = get_close_matches(column, known, n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return f"{path}: column {column!r} is missing or empty.{hint}{mapping_hint(known)}"


def mapping_hint(known: list[str]) -> str:
    """Return the advice to use a mapping, naming the one that uses most of the columns if there is one."""
    fits: dict[str, int] = {}
    own = {column for quantity in find_mapping("aerial_gym").quantities().values() for column in quantity.columns}
    for name in mapping_names():
        layout = find_mapping(name)
        wanted = {
            column
            for key, quantity in layout.quantities().items()
            for column in quantity.columns
            if "{n}" not in column and key not in ("battery", *HEIGHTS)
        }
        if not wanted <= own and wanted <= set(known):
            fits[name] = len(wanted)
    if fits:
        best = max(fits, key=lambda name: fits[name])
        return f" The columns look like the mapping {best!r}: give --mapping {best}."
    return " Rename the columns, or describe them in a mapping file (--mapping FILE.yaml)."
