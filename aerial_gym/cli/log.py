"""``aerial-gym log inspect``, ``log convert`` and ``log plot``: logs of any format."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console

from aerial_gym.cli.terminal import print_table
from aerial_gym.config.console import json_line
from aerial_gym.errors import ConfigError

if TYPE_CHECKING:
    from aerial_gym.sim2real.logs.inspection import FlightSummary, LogInspection
    from aerial_gym.sim2real.logs.readers.mapping import LogMapping
    from aerial_gym.sim2real.logs.recording import StreamTiming

ENDS = {
    "impact": "an impact (touchdown or crash)", "gap": "a gap", "velocity_reset": "a reset of the velocity",
    "log_end": "the end of the log",
}  # fmt: skip
"""Reasons for the end of a flight, in words."""


@dataclass(frozen=True, kw_only=True)
class LogCmd:
    """Base of the commands: a log and the meaning of its columns."""

    log: Annotated[Path, tyro.conf.Positional]  # Log file of any format; FILE#2 selects its second flight
    mapping: str | None = None  # Mapping of a CSV file, or of further topics: a name or a file (.yaml)

    def find_mapping(self) -> "LogMapping | None":
        """Return the mapping, None if none was given."""
        from aerial_gym.sim2real.logs.readers.mapping import find_mapping

        return None if self.mapping is None else find_mapping(self.mapping)


@dataclass(frozen=True, kw_only=True)
class InspectLogCmd(LogCmd):
    """Show what a log holds: topics, rates, flights, delays, messages, and what its rates do not allow."""

    draft_mapping: Path | None = None
    """File (.yaml) for the draft of a mapping: columns by their names, units and frames by the motion. Check it, then give
    it as --mapping. For CSV files with other columns than this package's."""

    json: bool = False  # Print one JSON object instead of tables

    def run(self) -> int:
        """Print the content; return 1 if no flight of the log can be used."""
        from aerial_gym.sim2real.logs.inspection import inspect_log
        from aerial_gym.sim2real.wording import render_findings

        mapping = self.find_mapping() if self.draft_mapping is None else self._write_draft(self.draft_mapping)
        inspection = inspect_log(self.log, mapping)
        if self.json:
            print(json_line(render_findings(inspection.as_mapping()), allow_nan=False))
        else:
            _print_inspection(inspection)
        return int(all(flight.refusal is not None for flight in inspection.flights))

    def _write_draft(self, path: Path) -> "LogMapping":
        from aerial_gym.sim2real.logs.mapping_draft import draft_mapping

        if self.mapping is not None:
            raise ConfigError("--mapping and --draft-mapping: give only one of them")
        if path.exists():
            raise ConfigError(
                f"--draft-mapping {path}: exists, and may hold your corrections; remove it, or name another file"
            )
        draft = draft_mapping(self.log)
        path.write_text(draft.as_yaml(), encoding="utf-8")
        if not self.json:
            print(f"{path}:\n{draft.as_yaml()}")
        return draft.mapping


@dataclass(frozen=True, kw_only=True)
class ConvertLogCmd(LogCmd):
    """Write a log as CSV (one file for each flight), Parquet (lossless, one file for each topic) or MCAP.

    Foxglove and Lichtblick open the MCAP file: vehicle, poses and path, plots of states and commands.
    """

    to: Literal["csv", "parquet", "mcap"]  # Form of the result
    out: Path  # Folder of the results; it is made if it does not exist
    robot: str | None = None  # Robot, or robot file, for mcap: its shape, and the residuals of its predictions

    def run(self) -> int:
        """Write the files and print their names."""
        from aerial_gym.sim2real.logs.conversion import convert_log

        if self.to != "mcap":
            if self.robot is not None:
                raise ConfigError(
                    f"--robot {self.robot}: --to {self.to} holds no vehicle; leave it out, or give --to mcap"
                )
            shown: dict[str, Any] = {}
        else:
            shown = self._vehicle_and_residuals()
        for path in convert_log(self.log, self.to, self.out, self.find_mapping(), **shown):
            print(path)
        return 0

    def _vehicle_and_residuals(self) -> dict[str, Any]:
        """Return the arguments of ``convert_log`` for the robot; a small quadrotor without residuals if none is given."""
        from aerial_gym.robots.catalog import robot_by_name
        from aerial_gym.task.chase_view import visible_parts

        if self.robot is None:
            return {"vehicle": visible_parts(robot_by_name("base_quadrotor"))}
        from aerial_gym.sim2real import replay
        from aerial_gym.sim2real.flight_replay import residual_tables

        result = replay(self.robot, [self.log], mapping=self.mapping)
        return {"vehicle": visible_parts(result.robot), "residuals": residual_tables(result)}


@dataclass(frozen=True, kw_only=True)
class PlotLogCmd(LogCmd):
    """Draw all flights of a log over time into one HTML file."""

    out: Path  # HTML file to write

    def run(self) -> int:
        """Write the page."""
        from aerial_gym.sim2real.logs.readers.flight_log import open_log
        from aerial_gym.sim2real.report.log_plot import write_log_page
        from aerial_gym.sim2real.wording import text

        flights = list(open_log(self.log, self.find_mapping(), partial=True).flights())
        notes = dict.fromkeys(text(note) for flight in flights for note in flight.notes)
        write_log_page(self.out, self.log.name, flights, list(notes))
        print(self.out)
        return 0


def _print_inspection(log: "LogInspection") -> None:
    """Print the flights with their consequences, findings on the file, the next step, and last its topics."""
    from aerial_gym.sim2real.wording import text

    console = Console(markup=False)
    console.print(f"{log.raw.path}: {log.raw.format}, {len(log.flights)} flight{'' if len(log.flights) == 1 else 's'}")
    for refusal in log.refusals:
        console.print(f"refused: {refusal}")
    for flight in log.flights:
        _print_flight(flight)
    for note in log.notes:
        console.print(f"note: {text(note)}")
    times: dict[tuple[str, str], list[float]] = {}
    for message in log.warnings:
        times.setdefault((message.level, message.text), []).append(message.time)
    for (level, sentence), at in times.items():
        repeats = f" and {len(at) - 1} times more until {at[-1]:.2f} s" if len(at) > 1 else ""
        console.print(f"{level} at {at[0]:.2f} s{repeats}: {sentence}")
    if any(flight.refusal is None for flight in log.flights):
        console.print(
            f"next: aerial-gym replay ROBOT.yaml {log.raw.path}; without a robot file: aerial-gym robot from-log"
        )
    if log.armed:
        console.print("armed: " + ", ".join(f"{start:.2f} to {end:.2f} s" for start, end in log.armed))
    for name, value in log.raw.metadata.items():
        console.print(f"  {name}: {value}")
    rows = [
        (f"{t.name}[{t.instance}]", str(t.samples), *map(_number_text, (t.rate, t.start, t.end, t.longest_gap)))
        for t in log.topics
    ]
    print_table(rows, ("topic", "samples", "rate [Hz]", "first [s]", "last [s]", "longest gap [s]"), title="topics")


def _print_flight(flight: "FlightSummary") -> None:
    from aerial_gym.sim2real.wording import text

    console = Console(markup=False)
    voltage = "" if flight.battery is None else f", battery {flight.battery[0]:.2f} to {flight.battery[1]:.2f} V"
    if flight.vertical_force is not None:
        voltage += f", mean vertical specific force {flight.vertical_force:.2f} m/s² (9.81 for a sound accelerometer)"
    span = f"{flight.start:.2f} to {flight.end:.2f} s, ended by {ENDS.get(flight.ended_by, flight.ended_by)}"
    console.print(f"{flight.path}: {span}{voltage}")
    if flight.refusal is not None:
        console.print(f"  refused by comparisons: {flight.refusal}")
    for note in flight.notes:
        console.print(f"  note: {text(note)}")
    rows = [
        (name, each.source, _number_text(each.rate), _number_text(each.latency, 1e3), _delay_text(each))
        for name, each in flight.streams.items()
    ]
    print_table(rows, ("quantity", "topic", "rate [Hz]", "latency [ms]", "late by [ms]"))


def _delay_text(stream: "StreamTiming") -> str:
    if stream.delay is None:
        return ""
    lag = " with the rotor lag" if stream.with_lag else ""
    return f"{1e3 * stream.delay:.1f} ± {1e3 * (stream.half_width or 0.0):.1f}{lag}"


def _number_text(value: float | None, scale: float = 1.0) -> str:
    return "" if value is None else f"{scale * value:.4g}" if abs(value) < 1e4 else f"{scale * value:.2f}"
