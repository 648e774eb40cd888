"""What noise of logged rotor speeds makes of what is predicted from them: ``python -m benchmarks.scores.attenuation``.

The plant knows the true speeds. For each force and torque that the rotors make together, the true one is fitted by a multiple
of that from the logged speeds, and of that from the expected ones (``sim2real/predict/rows/rotor_estimate.py``), below 10 Hz. A
multiple of 1 is what a prediction needs; with less, a fit of the effects makes them smaller by as much.
Letters: T rows, M modes (thrust, roll, pitch, yaw).
"""

import json
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.sim2real.logs.flights import complete_flight
from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
from aerial_gym.sim2real.logs.signals import lowpass, uniform_log
from aerial_gym.sim2real.predict.rows.rotor_estimate import estimate_rotors
from benchmarks.undeclared.cases import SETTLE_S, fly_case
from benchmarks.undeclared.dynamics import ROTOR
from benchmarks.undeclared.logs import write_log, write_robot
from benchmarks.undeclared.simulate import CONTROL_RATE

Array = NDArray[np.float64]

BAND_HZ = 10.0
EDGE_S = 1.0
"""Left out at both ends [s]."""

MODES = {"thrust": (1, 1, 1, 1), "roll": (-1, -1, 1, 1), "pitch": (1, -1, -1, 1), "yaw": (-1, 1, -1, 1)}
"""Signs of the rotors of the plant, ``benchmarks.undeclared.vehicle``."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One kind of flight: means over flights, and over seeds."""

    flights: str
    source: str
    """Of the speeds: logged, expected, or expected without logged commands."""

    number: int
    slope: dict[str, float]
    """Of the true over the found motion in each mode."""

    left: dict[str, float]
    """Rms of what is missed over that of the true motion."""


def in_modes(speed: Array) -> Array:
    """Return the motion in the band, without ends, (T, M)."""
    edge = round(EDGE_S * CONTROL_RATE)
    part = lowpass(speed @ np.array(list(MODES.values()), dtype=float).T / 2.0, CONTROL_RATE, BAND_HZ)[edge:-edge]
    return part - part.mean(axis=0)


def measured(seed: int) -> dict[tuple[str, str], list[tuple[Array, Array]]]:
    """Return slopes and what is left, each (M,), of every flight of a case, by kind of flight and source."""
    case = fly_case(effects={}, seed=seed, nuisance=True, features=("hover",))
    first, found = round(SETTLE_S * CONTROL_RATE), dict[tuple[str, str], list[tuple[Array, Array]]]()
    with tempfile.TemporaryDirectory() as folder:
        write_robot(Path(folder) / "robot.yaml", case.declared)
        robot = robot_by_name(Path(folder) / "robot.yaml")
        for number, flight in enumerate(case.flights):
            kind = "hover" if flight.family == "hover" else "moving"
            path = Path(folder) / f"{flight.name}.csv"
            write_log(path, case.record, number, first=first, every=1)
            log = complete_flight(uniform_log(read_flight_log(path)))
            true = in_modes(case.record.state[first:, number, ROTOR])
            assert log.rotor_speed is not None
            told, untold = (
                estimate_rotors(robot, [one], BAND_HZ)[0] for one in (log, replace(log, rotor_command=None))
            )
            assert told is not None
            assert untold is not None
            sources = {"logged": log.rotor_speed, "expected": told.speed, "expected, no commands": untold.speed}
            for name, speed in sources.items():
                seen = in_modes(speed)
                slope = (true * seen).sum(axis=0) / np.maximum((seen**2).sum(axis=0), 1e-12)
                missed = np.sqrt(((true - seen) ** 2).mean(axis=0) / (true**2).mean(axis=0))
                found.setdefault((kind, name), []).append((slope, missed))
    return found


def rows_of(seeds: list[int]) -> list[Row]:
    """Return a row for each kind of flight and source."""
    cases, rows = [measured(seed) for seed in seeds], []
    for kind, source in cases[0]:
        pairs = [one for case in cases for one in case[kind, source]]
        slope, left = (np.array(part) for part in zip(*pairs, strict=True))
        rows.append(
            Row(
                flights=kind,
                source=source,
                number=len(slope),
                slope=dict(zip(MODES, slope.mean(axis=0).round(3).tolist(), strict=True)),
                left=dict(zip(MODES, left.mean(axis=0).round(3).tolist(), strict=True)),
            )
        )
    return rows


def draw(rows: list[Row], path: Path) -> None:
    """Draw the slopes side by side."""
    from matplotlib import pyplot as plt

    colours = {"logged": "#b03a2e", "expected": "#1f618d", "expected, no commands": "#7fb3d5"}
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.2), sharey=True, layout="constrained")
    for axis, kind in zip(axes, ("hover", "moving"), strict=True):
        own = [row for row in rows if row.flights == kind]
        for place, row in enumerate(own):
            at = np.arange(len(MODES)) + 0.26 * (place - 1)
            axis.bar(at, list(row.slope.values()), 0.25, color=colours[row.source], label=row.source)
        axis.axhline(1.0, color="black", linewidth=0.8)
        axis.set_xticks(range(len(MODES)), list(MODES))
        axis.set_title(f"{own[0].number} flights: {kind}")
    axes[0].set_ylabel("true motion over found motion")
    axes[1].legend(frameon=True, fontsize=8, loc="lower right")
    figure.savefig(path, dpi=120)


@dataclass(frozen=True, kw_only=True)
class AttenuationCmd:
    """Compare motion from logged and from expected rotor speeds with the true one."""

    seeds: list[int]
    """Cases of the plant, nothing hidden, with the errors of a careful declaration: four flights hover, three move."""

    picture: Path | None = None
    """PNG to write."""

    json: bool = False
    """Print one object a line."""

    def run(self) -> None:
        """Print one row per kind of flight and source."""
        rows = rows_of(self.seeds)
        if self.picture is not None:
            draw(rows, self.picture)
        if self.json:
            for row in rows:
                print(json.dumps(vars(row)))
            return
        table = Table("flights", "speeds", "number", *(f"{mode}: slope (missed)" for mode in MODES))
        for row in rows:
            cells = [f"{row.slope[mode]:.2f} ({row.left[mode]:.2f})" for mode in MODES]
            table.add_row(row.flights, row.source, str(row.number), *cells)
        Console().print(table)


if __name__ == "__main__":
    tyro.cli(AttenuationCmd).run()
