"""The page of recorded flights: legend, time slider, playback controls and plots. Times are from the flight's first row [s]."""

import time
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.judge.evaluation import reason_against_rollouts
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import FlightLog
from aerial_gym.sim2real.wording import text
from aerial_gym.viewer.flight_record import FlightRecord, record_flight, with_rollouts
from aerial_gym.viewer.recording_scene import COLORS, RecordingScene
from aerial_gym.viewer.time_plots import TimePlots

if TYPE_CHECKING:
    from viser import GuiSliderHandle, ViserServer

MEANING = {
    "measured": "as logged",
    "declared": "predicted with the robot file",
    "corrected": "predicted with the corrected robot file",
}
HEX = {name: "#{:02x}{:02x}{:02x}".format(*color) for name, color in COLORS.items()}
FRAME_S, PLOT_S = 1.0 / 30.0, 0.1  # Time between two drawings of the scene, and of plots and slider [s]
MARKS = 60  # Most events that are marked on the slider
SPEEDS = {"0.1 x": 0.1, "0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "5 x": 5.0, "20 x": 20.0}
SPANS = {"5 s": 5.0, "20 s": 20.0, "60 s": 60.0, "whole flight": np.inf}
NONE: str = "-"  # Entry of a list while nothing is chosen


class RecordingPage:
    """Controls and scene of the flights of some logs. One thread, that of ``run``, reads the controls and draws."""

    def __init__(
        self, server: "ViserServer", flights: Sequence[FlightLog | Flight], robots: Mapping[str, RobotCfg], *,
        notes: Sequence[str] = (), restart_s: float = 0.5,
    ) -> None:  # fmt: skip
        """Add the controls and show the first flight; ``restart_s``: time between restarts of the predictions [s]."""
        self._server, self._robots, self._notes = server, robots, notes
        names = [flight.name for flight in flights]
        self._flights = {f.name if names.count(f.name) == 1 else f.path: f for f in flights}
        self._scene, gui = RecordingScene(server, robots), server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, control_layout="collapsible", control_width="large"
        )
        self._legend = gui.add_html("")
        self._flight = gui.add_dropdown("flight", tuple(self._flights), visible=len(flights) > 1)
        self._slider: GuiSliderHandle[float] | None = None
        self._button, self._presses, self.playing = gui.add_button("pause"), 0, True
        self._button.on_click(self._count_press)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x")
        self._event = gui.add_dropdown("jump to", (NONE,))
        self._restart = gui.add_number(
            "restart every [s]", restart_s, min=0.1, max=10.0, step=0.1,
            hint="The predictions start anew from the measured state after this time",
        )  # fmt: skip
        self._follow = gui.add_checkbox("follow the vehicle", True)
        self._quantity = gui.add_dropdown("plot", (NONE,))
        self._span = gui.add_dropdown("time span", tuple(SPANS), initial_value="20 s")
        self._plots: TimePlots | None = None
        self._remarks = gui.add_html("", order=1e12)
        self._open_flight()

    def run(self) -> None:
        """Play until interrupted."""
        last = time.monotonic()
        while True:
            now = time.monotonic()
            self.advance(now - last)
            last = now
            time.sleep(max(0.0, FRAME_S - (time.monotonic() - now)))

    def advance(self, elapsed: float) -> None:
        """Answer the controls, play on by ``elapsed`` [s] and draw."""
        if self._flight.value != self._name:
            self._open_flight()
        if self._restart.value != self._restarted:
            self._predict()
        if self._quantity.value != self._plotted:
            self._replace_plots()
        played = self._read_time(elapsed)
        with self._server.atomic():
            self._scene.draw(self.record.row_of_time(self.time), played, follow=self._follow.value)
        self._since_plot += elapsed
        shown = self.time, self._span.value
        if self._since_plot >= PLOT_S and shown != self._shown:
            self._shown, self._since_plot = shown, 0.0
            self._show_time()

    def _read_time(self, elapsed: float) -> float:
        """Move to the present instant by slider, events, button and playback; return the flight time played [s]."""
        assert self._slider is not None
        last = float(self.record.time[-1])
        if self._presses:
            self._presses, self.playing = 0, not self.playing
            self.time = 0.0 if self.playing and self.time >= last else self.time
        if self._slider.value != self._slid:
            self.time = self._slid = self._slider.value
        if self._event.value != NONE:
            self.time, self._event.value = self._events[self._event.value], NONE
        played = min(SPEEDS[self._speed.value] * elapsed, last - self.time) if self.playing else 0.0
        self.time += played
        self.playing &= self.time < last
        label = "pause" if self.playing else "play"
        if self._button.label != label:
            self._button.label = label
        return played

    def _show_time(self) -> None:
        """Move slider, plots and measured path to the present instant."""
        assert self._slider is not None
        assert self._plots is not None
        self._slid = round(self.time, 2)
        self._slider.value = self._slid
        start, end = self.time - 0.5 * SPANS[self._span.value], self.time + 0.5 * SPANS[self._span.value]
        self._plots.show(self.time, start, end)
        self._scene.draw_measured_path(start, end)

    def _count_press(self, _: object) -> None:
        self._presses += 1

    def _open_flight(self) -> None:
        """Show the chosen flight from its start."""
        self._name, self.time, self._slid = self._flight.value, 0.0, 0.0
        self.record = record_flight(self._flights[self._name], self._robots, self._notes)
        self._events = {f"{at:.2f} s: {words}": at for at, words in self.record.events}
        self._event.options, self._event.visible = (NONE, *self._events), bool(self._events)
        if self._slider is not None:
            self._slider.remove()
        last, marks = round(float(self.record.time[-1]), 2), list(self._events.values())[:MARKS]
        self._slider = self._server.gui.add_slider(
            "time [s]", 0.0, last, 0.01, 0.0, marks=((0.0, "0"), *((at, "") for at in marks), (last, f"{last:g}")),
            order=self._button.order - 0.5,
        )  # fmt: skip
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.record.notes)
        self._remarks.content = f'<div style="margin:1em;font-size:0.75em"><b>Notes</b><ul>{notes}</ul></div>'
        self._predict()

    def _predict(self) -> None:
        """Compute the predictions with the chosen time between restarts, and draw all that shows them."""
        self._restarted = float(self._restart.value)
        self.record = with_rollouts(self.record, self._restarted)
        self._restart.visible = bool(self.record.tracks)
        self._legend.content = legend(self.record, self._restarted, bool(self._robots))
        self._scene.show(self.record)
        self._quantity.options = tuple(self.record.plots())
        self._replace_plots()

    def _replace_plots(self) -> None:
        if self._plots is not None:
            self._plots.remove()
        self._plotted, self._shown, self._since_plot = self._quantity.value, None, PLOT_S
        self._plots = TimePlots(self._server, self.record.plots()[self._plotted], HEX)


def legend(record: FlightRecord, restart_s: float, has_robot: bool) -> str:
    """Return the colours of the vehicles and the limits of the predictions as HTML, with texts of logs escaped."""
    rows = [
        f'<div><span style="color:{HEX[name]}">&#9632;</span> <b>{name}</b>: {MEANING[name]}</div>'
        for name in ("measured", *record.robots)
    ]
    remarks = [] if record.has_position else ["The log has no position: the vehicles turn in place."]
    if record.tracks:
        remarks += [
            f"Prediction errors grow with time, so the predictions start anew from the measured state every {restart_s:g} s.",
            "They are hidden on the ground and in gaps of the log.",
        ]
        if not getattr(record.log, "torques", True):
            remarks.append("They take the measured attitude, since the log's rotor data determine no torques.")
    elif record.robots and isinstance(record.log, Flight):
        reason = reason_against_rollouts([record.log])
        remarks.append("Residuals only, no predicted vehicles. " + ("" if reason is None else text(reason)))
    elif has_robot:
        remarks.append("No predictions: the log does not suit the robot. The notes below name the reason.")
    else:
        remarks.append("Give --robot for the vehicle's shape, predictions and residuals; body axes are drawn here.")
    body = "".join(rows) + f"<p>{escape(' '.join(remarks))}</p>"
    return f'<div style="margin:0.5em 1em;font-size:0.85em">{body}</div>'
