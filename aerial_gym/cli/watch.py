"""``aerial-gym watch``: failures of a flight from its log as it is written."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from aerial_gym.config.console import json_line

if TYPE_CHECKING:
    from aerial_gym.config.robot import RobotCfg
    from aerial_gym.sim2real.arrays import Array
    from aerial_gym.sim2real.failures.watch import Alarm, FlightWatch
    from aerial_gym.sim2real.logs.readers.csv_lines import CsvHeader

SHOWN = 3  # Bad lines that are named


@dataclass(frozen=True, kw_only=True)
class WatchCmd:
    """Name a failure in flight, with rotor, size and time, from the rows of a log as they come."""

    robot: Annotated[str, tyro.conf.Positional]  # Registered robot, or a robot file (.yaml)
    log: Annotated[str, tyro.conf.Positional]  # Flight log of any format, FILE#2 for one of its flights; - for stdin
    mapping: str | None = None  # Mapping of columns or commands: a name or a file (.yaml); not with rows as they come
    follow: bool = False  # Wait for more rows at the end of the file, until interrupted
    false_alarm_hours: float = 100.0  # Mean flight time between two false alarms [h], at least
    json: bool = False  # Print one JSON object a line in place of sentences

    def run(self) -> int:
        """Print a line for each failure at its detection; return the exit status."""
        from aerial_gym.errors import ConfigError
        from aerial_gym.interop import one_thread
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.sim2real.logs.readers.follow import file_lines, is_log_of_flights, stdin_lines

        robot, whole = robot_by_name(self.robot), self.log != "-" and not self.follow
        if self.mapping is not None and not whole:
            raise ConfigError(
                "--mapping reads a whole log, and --follow and - take rows as they come; give only one of them"
            )
        if whole and (self.mapping is not None or is_log_of_flights(self.log)):
            with one_thread():
                self._watch_logged_flights(robot)
            return 0
        lines = stdin_lines() if self.log == "-" else file_lines(Path(self.log), follow=self.follow)
        with one_thread():
            for number, flight in enumerate(_lines_of_flights(lines)):
                if number:
                    print(f"{self.log}: begins anew; watched from its first row on", file=sys.stderr)
                if not self._watch_flight(robot, flight):
                    break
        return 0

    def _watch_logged_flights(self, robot: "RobotCfg") -> None:
        """Print a line for each failure in the flights of a binary log, or in the selected flight of any log."""
        from aerial_gym.sim2real.failures.watch import FlightWatch
        from aerial_gym.sim2real.logs.conversion import flight_table
        from aerial_gym.sim2real.logs.flights import scale_relative_commands
        from aerial_gym.sim2real.logs.readers.flight_log import open_log
        from aerial_gym.sim2real.logs.readers.mapping import find_mapping
        from aerial_gym.sim2real.wording import text

        layout = None if self.mapping is None else find_mapping(self.mapping)
        for flight in open_log(self.log, layout).flights():
            table = flight_table(scale_relative_commands(flight, robot))
            settings = {"torques": flight.torques, "false_alarm_hours": self.false_alarm_hours}
            watch = FlightWatch(robot, list(table), name=flight.name, **settings)
            for note in (note for note in flight.notes if note.code == "rotors_too_slow"):
                print(f"{flight.name}: {text(note)}", file=sys.stderr)
            self._print_alarms(watch, _alarms_of_rows(watch, table.to_numpy()))

    def _print_alarms(self, watch: "FlightWatch", alarms: "Iterator[Alarm]") -> bool:
        """Print a line for each alarm, then a summary; return False if it was interrupted."""
        from aerial_gym.sim2real.failures.watch import NAMED
        from aerial_gym.sim2real.wording import render_findings, text

        named, interrupted = 0, False
        try:
            for alarm in alarms:
                named += alarm.stage == NAMED
                sentence = f"{alarm.stage} at {alarm.told_s:.2f} s: {text(alarm.failure.finding)}"
                print(json_line(render_findings(alarm.as_mapping())) if self.json else sentence, flush=True)
        except KeyboardInterrupt:
            if not self.follow:
                raise
            interrupted = True
        print(f"watched {watch.watched_s:.1f} s: {named or 'no'} failure{'' if named == 1 else 's'}", file=sys.stderr)
        return not interrupted

    def _watch_flight(self, robot: "RobotCfg", lines: Iterator[str]) -> bool:
        """Print a line for each failure in the lines of one flight, then a summary; return False if it was interrupted."""
        from aerial_gym.errors import DataError
        from aerial_gym.sim2real.failures.watch import FlightWatch
        from aerial_gym.sim2real.logs.readers.csv_lines import find_header

        numbered = enumerate(lines, start=1)
        header = find_header((line for _, line in numbered), "t")
        if header is None and self.follow:  # restarted before its first line was written
            return True
        if header is None:
            raise DataError(f"{self.log}: holds no header line")
        name = "flight" if self.log == "-" else Path(self.log).stem
        watch = FlightWatch(robot, header.names, name=name, false_alarm_hours=self.false_alarm_hours)
        return self._print_alarms(watch, _alarms_of_lines(watch, header, numbered, self.log, refuse=not self.follow))


def _alarms_of_rows(watch: "FlightWatch", rows: "Array") -> "Iterator[Alarm]":
    for row in rows:
        yield from watch.add(row)
    yield from watch.finish()


def _lines_of_flights(lines: Iterator[str | None]) -> Iterator[Iterator[str]]:
    """Yield the lines of each flight: a None between lines begins another one."""
    ended = False

    def flight() -> Iterator[str]:
        nonlocal ended
        for line in lines:
            if line is None:
                return
            yield line
        ended = True

    while not ended:
        yield flight()


def _alarms_of_lines(
    watch: "FlightWatch", header: "CsvHeader", lines: Iterator[tuple[int, str]], log: str, *, refuse: bool
) -> "Iterator[Alarm]":
    """Yield the alarms while lines come, and when they end; name the first rows that are left out, and count all.

    Raises:
        DataError: If no row can be used, and ``refuse`` is set.
    """
    from aerial_gym.errors import DataError
    from aerial_gym.sim2real.wording import text

    rows = unreadable = named = 0
    for number, line in lines:
        if header.is_remark(line):
            continue
        row, rows = _row_numbers(header.comma_separated_line(line.rstrip("\r\n"))), rows + 1
        if row is None:
            unreadable += 1
            named += _report_bad_row(named, f"{log}, line {number}: its fields do not fit the header or are no numbers")
            continue
        before = watch.bad_rows
        yield from watch.add(row)
        if watch.bad_rows > before:
            assert watch.last_bad is not None
            named += _report_bad_row(named, f"{log}, by line {number}: {text(watch.last_bad)}")
    yield from watch.finish()
    bad = unreadable + watch.bad_rows
    if refuse and bad == rows:
        fault = f"none of its {rows} rows can be used" if rows else "holds no rows"
        raise DataError(f"{log}: {fault}; is it a flight log?")
    if bad:
        print(f"{log}: {bad} of {rows} rows left out", file=sys.stderr)
    if watch.clock_steps:
        print(f"{log}: its clock was set back {watch.clock_steps} times", file=sys.stderr)


def _report_bad_row(named: int, sentence: str) -> bool:
    """Print the reason for a left-out row, for the first ``SHOWN`` rows; return whether it was printed."""
    if named < SHOWN:
        print(f"row left out: {sentence}", file=sys.stderr)
    return named < SHOWN


def _row_numbers(row: str | None) -> list[float] | None:
    """Return the fields of a row, empty ones as NaN; None if one is no number."""
    try:
        return None if row is None else [float(field.strip() or "nan") for field in row.split(",")]
    except ValueError:
        return None
