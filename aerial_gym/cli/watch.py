"""``aerial-gym watch``: failures of a flight from its log as it is written."""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from aerial_gym.sim2real.failures.watch import Alarm, Watch


@dataclass(frozen=True, kw_only=True)
class WatchCmd:
    """Name a failure in flight, with rotor, size and time, from the rows of a log as they come."""

    robot: Annotated[str, tyro.conf.Positional]
    """Registered robot, or a robot file (.yaml)."""

    log: Annotated[str, tyro.conf.Positional]
    """Flight log (CSV of this package's layout), or - for stdin."""

    follow: bool = False
    """Wait for more rows at the end of the file, until interrupted."""

    false_alarm_hours: float = 100.0
    """Mean flight time between two false alarms [h], at least."""

    json: bool = False
    """Print one JSON object a line in place of sentences."""

    def run(self) -> int:
        """Print a line for each failure as soon as it is known; return the exit status."""
        from aerial_gym.errors import DataError
        from aerial_gym.interop import one_thread
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.sim2real.failures.watch import NAMED, Watch

        robot, lines, name = (
            robot_by_name(self.robot),
            self._lines(),
            "flight" if self.log == "-" else Path(self.log).stem,
        )
        header = next(lines, "")
        if not header.strip():
            raise DataError(f"{self.log}: holds no header line")
        watch = Watch(robot, header.strip().split(","), name=name, false_alarm_hours=self.false_alarm_hours)
        named = 0
        with one_thread():
            for alarm in _alarms(watch, lines, self.log):
                named += alarm.stage == NAMED
                print(json.dumps(alarm.as_mapping(), ensure_ascii=False) if self.json else alarm.sentence, flush=True)
        print(f"watched {watch.watched_s:.1f} s: {named or 'no'} failure{'' if named == 1 else 's'}", file=sys.stderr)
        return 0

    def _lines(self) -> Iterator[str]:
        """Yield whole lines, those that are still to be written among them if they are to be waited for."""
        if self.log == "-":
            yield from sys.stdin
            return
        from aerial_gym.errors import DataError

        if not Path(self.log).is_file():
            raise DataError(f"{self.log}: no such file. Give a flight log (CSV), or - for rows from stdin")
        with Path(self.log).open(encoding="utf-8-sig") as file:
            part = ""
            while True:
                line = file.readline()
                part += line
                if part.endswith("\n"):
                    yield part
                    part = ""
                elif not line:
                    if not self.follow:
                        break
                    time.sleep(0.05)
            if part:
                yield part


def _alarms(watch: "Watch", lines: Iterator[str], log: str) -> "Iterator[Alarm]":
    """Yield what is told while lines come, and when they end."""
    for number, line in enumerate(lines, start=2):
        yield from watch.add(_numbers(line, f"{log}, line {number}"))
    yield from watch.ended()


def _numbers(line: str, where: str) -> list[float]:
    """Return the fields of a line, empty ones as NaN."""
    from aerial_gym.errors import DataError

    try:
        return [float(field) if field.strip() else float("nan") for field in line.rstrip("\n").split(",")]
    except ValueError as error:
        raise DataError(f"{where}: {error}") from None
