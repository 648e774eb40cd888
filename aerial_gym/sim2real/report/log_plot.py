"""One page with the time courses of all flights of a log."""

from pathlib import Path

from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.report.canvas import panels
from aerial_gym.sim2real.report.page import write_page
from aerial_gym.sim2real.report.plots import FLIGHTS
from aerial_gym.sim2real.wording import text

AXES = ("x", "y", "z", "w")
SHOWN = {
    "attitude": "attitude, xyzw",
    "ang_vel": "angular velocity [rad/s]",
    "specific_force": "specific force [m/s²]",
    "lin_vel": "velocity [m/s]",
    "position": "position [m]",
    "rotor_speed": "rotor speed [rad/s]",
    "rotor_command": "rotor command",
    "battery": "battery [V]",
}
"""Title of the panel of each quantity."""


def write_log_page(path: Path, name: str, flights: list[FlightLog], notes: list[str]) -> None:
    """Write an HTML file with one figure for each flight, and notes on the log and its absent quantities."""
    if absent := [name for name in SHOWN if all(getattr(log, name) is None for log in flights)]:
        notes = [text(Finding("quantities_absent", "", {"quantities": absent})), *notes]
    context = {"name": name, "figures": [(log.name, flight_figure(log)) for log in flights], "notes": notes}
    write_page(path, "log.html", context)


def flight_figure(log: FlightLog) -> str:
    """Return the quantities of a flight over time as a figure."""
    known = [quantity for quantity in SHOWN if getattr(log, quantity) is not None]
    figure, grid = panels(len(known), 1, width=9.0, height=1.4, title="", sharex=True, zooms=True)
    for quantity, (panel,) in zip(known, grid, strict=True):
        columns = getattr(log, quantity).reshape(log.time.size, -1).T
        labels = [f"rotor {n + 1}" for n in range(len(columns))] if quantity.startswith("rotor") else AXES
        for column, label, colour in zip(columns, labels, FLIGHTS * 2, strict=False):
            panel.line(log.time, column, colour, label=label if len(columns) > 1 else "")
        panel.title, panel.boxed = SHOWN[quantity], len(columns) > 1
    grid[-1][0].x_label = "t [s]"
    return figure.html()
