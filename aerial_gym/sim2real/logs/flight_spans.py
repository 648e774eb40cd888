"""Split a log into flights: at arming, take-off, landing, gaps, resets of the velocity, and an impact at the end.

Letters: T samples.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.sim2real.arrays import Array, Flags, true_spans
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.time_courses import APART, SURPRISE
from aerial_gym.sim2real.logs.raw_log import NO_MOTION, STATES
from aerial_gym.sim2real.logs.recording import longest_bridgeable_gap
from aerial_gym.sim2real.logs.streams import Stream

SHORTEST_S = 2.0  # Shortest flight [s]
LEAST_COVERED = 0.5  # A stream that covers a smaller share of the airborne time is left out
LAST_S = 3.0  # Time before the end of a flight in which an impact ends it [s]
SHOCK_S = 0.01  # Time in which an impact changes the force [s]; thrust needs longer, as rotors lag
LEAST_SHOCK_G = 1.0  # Least change of the specific force by an impact [g]
SHOCK_RATIOS = (1.25, 2.0)  # Size of an impact relative to the largest and to the 99.9th percentile of changes before
BEFORE_IMPACT_S = 0.1  # Time cut off before an impact [s], for the contact that leads to it


@dataclass(frozen=True, kw_only=True)
class FlightSpan:
    """The time of one flight in a log, and the reason for its end."""

    start: float  # [s]
    end: float  # [s]
    ended_by: str  # landing, gap, velocity_reset, clock_set_back, impact or log_end

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.end - self.start


def flight_spans(streams: Mapping[str, Stream], notes: list[Finding]) -> list[FlightSpan]:
    """Return the flights of at least ``SHORTEST_S`` in order; the whole log if arming and landing show none."""
    measured = {name: stream for name, stream in streams.items() if name not in NO_MOTION}
    first, last = (bound(stream.time[end] for stream in _motion(measured)) for bound, end in ((max, 0), (min, -1)))
    for states in (STATES, STATES[:1], ()):
        known = [streams[name] for name in states if name in streams]
        spans = [
            part
            for span in _airborne_spans(known, float(first), float(last))
            for part in _split_span(span, list(_motion(measured)))
            if part.duration >= SHORTEST_S
        ]
        if spans or not states:
            break
    if not known and any(name in streams for name in STATES):
        notes.append(Finding("flight_state_unknown"))
    return [_end_at_impact(span, measured.get("specific_force")) for span in spans]


def _motion(streams: Mapping[str, Stream]) -> list[Stream]:
    """Return the streams that a comparison needs: all but the voltage."""
    return [stream for name, stream in streams.items() if name != "battery"]


def leave_out_partial_streams(streams: dict[str, Stream], notes: list[Finding]) -> dict[str, Stream]:
    """Return the streams that cover at least ``LEAST_COVERED`` of the time of the longest one; others become findings."""
    spans = {name: float(np.ptp(stream.time)) for name, stream in streams.items()}
    longest = max((spans[name] for name in streams if name not in (*NO_MOTION, "battery")), default=0.0)
    short = [name for name in streams if name not in NO_MOTION and spans[name] < LEAST_COVERED * longest]
    for name in short:
        values = {"topic": streams[name].channel.source, "covered_s": spans[name], "log_s": longest}
        notes.append(Finding("topic_covers_part", "", values))
    return {name: stream for name, stream in streams.items() if name not in short}


def _airborne_spans(states: Sequence[Stream], first: float, last: float) -> list[FlightSpan]:
    """Return the spans within ``first`` to ``last`` [s] in which the vehicle is armed and not landed."""
    events = np.unique(np.concatenate([[first, last], *(state.time for state in states)]))
    events = events[(events >= first) & (events <= last)]
    flies = np.ones(events.size, dtype=bool)
    for state in states:
        row = np.clip(np.searchsorted(state.time, events, side="right") - 1, 0, None)
        flies &= (state.values[row, 0] > 0.0) == (state.quantity == "armed")
    flies[-1] = False
    spans = [(float(events[start]), float(events[stop])) for start, stop in true_spans(flies)]
    return [FlightSpan(start=a, end=b, ended_by="log_end" if b == last else "landing") for a, b in spans]


def _split_span(span: FlightSpan, streams: Sequence[Stream]) -> list[FlightSpan]:
    """Return the parts of a span between gaps of any stream, clock steps with a jump of it, and resets of the velocity."""
    cuts = [(span.end, span.end, span.ended_by)]
    for stream in streams:
        for row in np.flatnonzero(np.diff(stream.time) > longest_bridgeable_gap(stream.sample_step)).tolist():
            cuts.append((float(stream.time[row]), float(stream.time[row + 1]), "gap"))
        for row in _discontinuous_clock_steps(stream):
            cuts.append((float(stream.time[row - 1]), float(stream.time[row]), "clock_set_back"))
        resets = stream.channel.resets if stream.quantity == "lin_vel" else None
        cuts += [
            (time - stream.sample_step, time, "velocity_reset") for time in ([] if resets is None else resets.tolist())
        ]
    parts, start = list[FlightSpan](), span.start
    for stop, following, reason in sorted(cuts):
        if span.start < following and stop <= span.end:
            if stop > start:
                parts.append(FlightSpan(start=start, end=stop, ended_by=reason))
            start = max(start, following)
    return parts


def _discontinuous_clock_steps(stream: Stream) -> list[int]:
    """Return the rows after backward clock steps across which the motion jumps, as after a restart of the vehicle."""
    rows = [step.row for step in stream.backward_steps]
    changes = np.linalg.norm(np.diff(stream.values, axis=0), axis=1)
    usual = np.delete(changes, [row - 1 for row in rows])
    if stream.quantity not in ("attitude", "position", "lin_vel") or not usual.size or not rows:
        return []
    return [row for row in rows if changes[row - 1] > APART * float(np.quantile(usual, 1.0 - SURPRISE))]


def _end_at_impact(span: FlightSpan, force: Stream | None) -> FlightSpan:
    """Return the span up to the first impact of its last seconds, as of a crash or a hard landing; unchanged without one."""
    if force is None:
        return span
    inside = (force.time >= span.start) & (force.time <= span.end)
    impacts = _impacts(force.time[inside], force.values[inside])
    if not impacts.size:
        return span
    flight = FlightSpan(start=span.start, end=float(impacts[0]) - BEFORE_IMPACT_S, ended_by="impact")
    return flight if flight.duration >= SHORTEST_S else span


def _impacts(time: Array, force: Array) -> Array:
    """Return the times [s] of impacts within the last ``LAST_S``."""
    rows = max(1, round(SHOCK_S / float(np.median(np.diff(time))))) if time.size > 1 else 1
    changes, time = np.linalg.norm(force[rows:] - force[:-rows], axis=1), time[rows:]
    return time[shocks(changes, time > time[-1] - LAST_S)] if time.size else time


def shocks(changes: Array, where: Flags) -> Flags:
    """Return the rows that changes of the force within ``SHOCK_S`` [m/s²], (T,), show as impacts; all lie in ``where``.

    There the change is larger than 1 g and than elsewhere in the flight. Without rows elsewhere there are none.
    """
    if where.all():
        return np.zeros_like(where)
    largest, of_percentile = SHOCK_RATIOS
    usual = min(largest * float(changes[~where].max()), of_percentile * float(np.percentile(changes[~where], 99.9)))
    return where & (changes > max(usual, LEAST_SHOCK_G * STANDARD_GRAVITY))
