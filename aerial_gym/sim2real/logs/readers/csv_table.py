"""Read the columns of a CSV file as numbers, and report each defect with its line and remedy. Letters: T rows."""

import csv
from collections.abc import Callable, Mapping, Sequence
from difflib import get_close_matches
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, true_spans
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.readers.csv_lines import find_header, read_lines
from aerial_gym.sim2real.logs.readers.log_readers import read_csv_export
from aerial_gym.sim2real.logs.readers.mapping import SCALARS, UNITS, ColumnsCfg, LogMapping, find_mapping, mapping_names
from aerial_gym.sim2real.logs.readers.stamps import MOST_BAD, SHOWN, correct_stamps, stamp_seconds

FEW_DIGITS = 20  # Time has too few digits if more than one row in so many repeats the time before
EMPTY = ("", "nan", "NaN", "NAN", "-nan", "null", "NULL", "None", "NA", "N/A", "-")  # Field values that mean 'no value'
LARGEST = 1e9  # Largest plausible measurement in SI units


def read_csv_rows(
    path: Path, layout: LogMapping, notes: list[Finding]
) -> tuple[pd.DataFrame, Array, tuple[float, ...]]:
    """Return the rows with valid time stamps, their time [s], (T,), and the corrected times of clock steps [s]."""
    table = drop_copied_rows(read_table(path, layout, notes), notes)
    stamps = correct_stamps(read_time_stamps(table, layout, str(path)), str(path))
    notes.extend(stamps.late_block_findings(table.index[stamps.late].to_numpy(dtype=int).tolist()))
    table = table.iloc[stamps.order]
    bad = table.index[~stamps.kept]
    _append_row_finding("rows_with_bad_stamps", bad.tolist(), len(table), notes)
    table = table.drop(index=bad)
    lines = table.index.to_numpy(dtype=int).tolist()
    notes.extend(step.finding("line", lines[step.row]) for step in stamps.steps)
    return table, stamps.time, tuple(float(stamps.time[step.row]) for step in stamps.steps)


def read_table(path: Path, layout: LogMapping, notes: list[Finding]) -> pd.DataFrame:
    """Return the table of a file by line number, NaN for empty fields; raise ``DataError`` if it is unusable."""
    export = read_csv_export(path)
    if export is None:
        table = _read_text_table(path, layout, notes)
    else:
        table = pd.DataFrame(dict(export.topics[0].columns))
        table.index = pd.RangeIndex(2, 2 + len(table))
    wanted = {name: q for q in layout.quantities().values() for name in _column_names(q, list(table.columns))}
    if twice := sorted(name for name in wanted if list(table.columns).count(name) > 1):
        raise DataError(f"{path}: column {twice[0]!r} appears twice in the header; rename or remove one of them")
    return _drop_rows_without_numbers(table, wanted, layout.time.columns[0], str(path), notes)


def _read_text_table(path: Path, layout: LogMapping, notes: list[Finding]) -> pd.DataFrame:
    """Return the rows of a text file that fit its header, by line number."""
    lines = read_lines(path)
    source = iter(enumerate(lines, start=1))
    header = find_header((line for _, line in source), layout.time.columns[0])
    body = [] if header is None else [(n, line) for n, line in source if not header.is_remark(line)]
    rows = [(n, header.comma_separated_line(line)) for n, line in body] if header else []
    if header is None or not rows:
        raise DataError(f"{path}: holds no rows; a flight log has one header line and one line per sample")
    bad = [n for n, row in rows if row is None]
    if len(bad) > MOST_BAD * len(rows):
        raise DataError(
            f"{path}, line {bad[0]}: its fields do not fit the {len(header.names)} names of the header, as in {len(bad)} of "
            f"{len(rows)} lines; correct the header"
        )
    _append_row_finding("rows_not_of_header", bad, len(rows), notes, fields=len(header.names))
    table = pd.read_csv(
        StringIO("\n".join(row for _, row in rows if row is not None)),
        header=None,
        names=range(len(header.names)),  # the first row may be blank
        index_col=False,
        keep_default_na=False,
        na_values=list(EMPTY),
        quoting=csv.QUOTE_NONE,
        skip_blank_lines=False,
        skipinitialspace=True,
        float_precision="round_trip",
    )
    table.columns = pd.Index(header.names)
    table.index = pd.Index([n for n, row in rows if row is not None])
    return table


def _drop_rows_without_numbers(
    table: pd.DataFrame, wanted: Mapping[str, ColumnsCfg], time: str, path: str, notes: list[Finding]
) -> pd.DataFrame:
    """Return the table without rows whose wanted columns hold no numbers; a non-numeric time becomes NaN and stays."""
    bad, example = np.zeros(len(table), dtype=bool), dict[str, object]()
    for name, quantity in wanted.items():
        if name not in table.columns:
            continue
        filled, text = np.asarray(table[name].notna()), np.asarray(table[name])
        numbers = np.asarray(pd.to_numeric(table[name], errors="coerce"))
        size = np.abs(numbers.astype(np.float64)) * UNITS[quantity.unit]
        table[name] = np.where(np.isfinite(size), numbers, np.nan) if numbers.dtype.kind == "f" else numbers
        if name == time:
            continue
        wrong = filled & ~np.isfinite(size)
        if wrong.mean() > MOST_BAD:
            row = int(np.argmax(wrong))
            raise DataError(
                f"{path}, line {table.index[row]}: {name} = {text[row]!s} is no finite number, as in {wrong.mean():.0%} of the "
                "rows; leave the whole column empty if it was not measured"
            )
        far = size > LARGEST
        wrong |= far & (far.mean() <= MOST_BAD)  # a larger share indicates a wrong unit
        if wrong.any() and not bad.any():
            example = {"column": name, "field": str(text[int(np.argmax(wrong))])}
        bad |= wrong
    out = table.index[bad]
    _append_row_finding("rows_without_numbers", out.tolist(), len(table), notes, **example)
    return table.drop(index=out)


def _append_row_finding(code: str, lines: Sequence[int], total: int, notes: list[Finding], **more: object) -> None:
    """Append a finding with the number of dropped rows and the first of their lines."""
    if lines:
        notes.append(Finding(code, "", {"rows": len(lines), "total": total, "lines": list(lines[:SHOWN]), **more}))


def _column_names(quantity: ColumnsCfg, known: Sequence[str]) -> list[str]:
    """Return the column names of a quantity, with ``{n}`` expanded to the numbers in the file."""
    pattern, matrix = "".join(quantity.columns[:1]), []
    if len(quantity.columns) > 1 or "{n}" not in pattern:
        return list(quantity.columns)
    while (name := pattern.replace("{n}", str(len(matrix) + 1))) in known:
        matrix.append(name)
    return matrix


def quantity_columns(table: pd.DataFrame, quantity: ColumnsCfg, name: str, path: str) -> list[str]:
    """Return the columns of a quantity in the file; empty if all of them are missing or empty."""
    names = _column_names(quantity, list(table.columns))
    present = [column for column in names if column in table.columns and not bool(table[column].isna().all())]
    missing = [column for column in names if column not in present]
    if present and missing:
        raise DataError(
            f"{path}: column {missing[0]!r} is missing or empty while {present[0]!r} is there; "
            f"add it, or remove every column of {name}"
        )
    return present


def drop_copied_rows(table: pd.DataFrame, notes: list[Finding]) -> pd.DataFrame:
    """Return the table without rows that repeat an earlier one in every column, time included."""
    copies = np.asarray(table.duplicated())
    if not copies.any():
        return table
    notes.append(Finding("rows_copied", "", {"rows": int(copies.sum())}))
    return table.drop(index=table.index[copies])


def read_time_stamps(table: pd.DataFrame, layout: LogMapping, path: str) -> Array:
    """Return the logged time stamps [s], NaN where empty; refuse a missing column or too few digits."""
    column = layout.time.columns[0]
    if column not in table.columns or bool(table[column].isna().all()):
        raise DataError(message_on_missing_column(column, list(table.columns), path))
    stamps = stamp_seconds(table[column].to_numpy(), UNITS[layout.time.unit])
    steps = np.diff(stamps[np.isfinite(stamps)])
    still = int(np.sum(steps == 0.0))
    if still * FEW_DIGITS > stamps.size and np.all(steps >= 0.0):
        raise DataError(
            f"{path}: {column} is the same in {still} rows as in the row before; its digits are too few to tell rows apart, or "
            "rows of two flights were sorted by it: write the rows as they were measured, with more digits"
        )
    return stamps


def require_column(table: pd.DataFrame, column: str, path: str) -> Array:
    """Return a required column (T,) without gaps."""
    if column not in table.columns:
        raise DataError(message_on_missing_column(column, list(table.columns), path))
    return read_numbers(table, [column], ColumnsCfg(columns=(column,)), np.zeros(len(table)), path, [])[:, 0]


def read_numbers(
    table: pd.DataFrame, columns: list[str], quantity: ColumnsCfg, time: Array, path: str, notes: list[Finding], *,
    gaps: bool = False, held: bool = False,
) -> Array:  # fmt: skip
    """Return numbers (T, columns), short gaps filled by a line, or ``held``; with ``gaps`` NaN stays."""
    matrix, filled = np.empty((len(table), len(columns))), 0
    for index, column in enumerate(columns):
        numbers = np.asarray(pd.to_numeric(table[column], errors="coerce"), dtype=np.float64)
        if gaps:
            matrix[:, index] = numbers
            continue
        matrix[:, index] = _fill_short_gaps(
            numbers, quantity, time, lambda row, name=column: f"{path}, line {table.index[row]}: {name}", held=held
        )
        filled += int(np.isnan(numbers).sum())
    if filled:
        values = {"fields": filled, "first": columns[0], "last": columns[-1], "held": held}
        notes.append(Finding("fields_filled", "", values))
    return matrix


def _fill_short_gaps(
    numbers: Array, quantity: ColumnsCfg, time: Array, where: Callable[[int], str], *, held: bool
) -> Array:
    """Return ``numbers`` with short runs of NaN filled linearly or held; refuse long runs."""
    empty = np.isnan(numbers)
    if not empty.any():
        return numbers
    full_time = np.concatenate(([time[0]], time, [time[-1]]))
    for start, stop in true_spans(empty):
        gap = float(full_time[stop + 1] - full_time[start])
        if gap > quantity.fill_gap_s or quantity.fill_gap_s == 0.0:
            raise DataError(
                f"{where(start)} is empty (NaN) for {stop - start} rows while other rows have it; cut the flight there, "
                "fill the gap, or let a mapping file allow it (fill_gap_s)"
            )
    known = np.flatnonzero(~empty)
    if held:
        return numbers[known[np.maximum(np.searchsorted(known, np.arange(time.size), side="right") - 1, 0)]]
    return np.interp(time, time[known], numbers[known])


def apply_column_conversion(raw: Array, table: pd.DataFrame, quantity: ColumnsCfg, path: str) -> Array:
    """Return ``offset + gain (raw * times / over)^power``, and 0 where raw is 0, repeated per rotor, (T, columns)."""
    values = raw
    for column, power in ((quantity.times, 1.0), (quantity.over, -1.0)):
        if column is None:
            continue
        other = require_column(table, column, path)
        if np.any(other <= 0.0):
            row = int(np.argmax(other <= 0.0))
            raise DataError(f"{path}, line {table.index[row]}: {column} = {other[row]:g}, must be > 0")
        values = values * other[:, None] ** power
    if quantity.power != 1.0 and np.any(values < 0.0):
        raise DataError(f"{path}: {quantity.columns[0]} is negative and cannot be raised to {quantity.power:g}")
    values = np.where(raw == 0.0, 0.0, quantity.offset + quantity.gain * values**quantity.power)
    return np.repeat(values, quantity.repeat, axis=1)


def message_on_missing_column(column: str, known: list[str], path: str) -> str:
    """Return the message on a missing column, with the nearest existing name and the remedy."""
    near = get_close_matches(column, [name for name in known if name != column], n=1)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    return f"{path}: column {column!r} is missing or empty.{hint}{mapping_hint(known)}"


def mapping_hint(known: list[str]) -> str:
    """Return the advice to use a mapping; it names the built-in one with the most matching columns, if any."""
    fits: dict[str, int] = {}
    own = {column for quantity in find_mapping("aerial_gym").quantities().values() for column in quantity.columns}
    for name in mapping_names():
        layout = find_mapping(name)
        known_columns = [q.columns for key, q in layout.quantities().items() if key == "time" or key not in SCALARS]
        wanted = {column for columns in known_columns for column in columns if "{n}" not in column}
        if not wanted <= own and wanted <= set(known):
            fits[name] = len(wanted)
    if fits:
        best = max(fits, key=lambda name: fits[name])
        return f" The columns look like the mapping {best!r}: give --mapping {best}."
    return (
        " Describe the columns in a mapping file (--mapping FILE.yaml); "
        "`aerial-gym log inspect LOG --draft-mapping FILE.yaml` writes a draft of one."
    )
