"""Step responses of a rotor: time constants, slew limits and delay, selected by cross-validation over steps.

Letters: T rows, K parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.json_values import plain, select_fields
from aerial_gym.sim2real.statistics import Estimate
from aerial_gym.sim2real.teststand.statistics import LawFit, fit_law, smallest_good_candidate
from aerial_gym.sim2real.teststand.tables import Bench

SHORTEST_STEP = 5  # Least number of rows per step for a time constant
NO_LIMIT = 1e9  # Slew limit that stands for none [rad/s²]

BOUNDS: dict[str, tuple[float, float, float]] = {
    "tau": (0.03, 1e-3, 2.0),
    "tau_up": (0.03, 1e-3, 2.0),
    "tau_down": (0.04, 1e-3, 2.0),
    "delay": (0.005, 0.0, 0.2),
    "slew_up": (6e4, 1e2, 1e7),
    "slew_down": (3e4, 1e2, 1e7),
}
"""Initial value, lower and upper bound: tau and delay [s], slew [rad/s²]."""

LAWS: dict[str, tuple[str, ...]] = {
    "one time constant": ("tau",),
    "up and down": ("tau_up", "tau_down"),
    "up and down, delay": ("tau_up", "tau_down", "delay"),
    "one time constant, slew limit down": ("tau", "slew_down"),
    "up and down, slew limit down": ("tau_up", "tau_down", "slew_down"),
    "one time constant, slew limits": ("tau", "slew_up", "slew_down"),
    "up and down, slew limits": ("tau_up", "tau_down", "slew_up", "slew_down"),
    "up and down, slew limits, delay": ("tau_up", "tau_down", "slew_up", "slew_down", "delay"),
}
"""Parameters of each law."""

ROBOT_LAWS = tuple(name for name, params in LAWS.items() if "delay" not in params)
"""Laws that a robot file's rotor supports; a delay is the effect ``actuation_delay``."""


@dataclass(frozen=True, kw_only=True)
class StepRecord:
    """Record with piecewise constant commands."""

    path: str
    time: Array  # [s], (T,)
    command: Array  # [rad/s], (T,)
    measured: Array  # [rad/s], (T,)
    starts: Indices  # First row of each step, with T at the end

    @property
    def levels(self) -> Array:
        """Speed before the first step and command of each step [rad/s]."""
        return np.append(self.measured[self.starts[0]], self.command[self.starts[:-1]])


@dataclass(frozen=True, kw_only=True)
class StepFit:
    """Fits of all laws, and the selected one."""

    records: tuple[StepRecord, ...]
    laws: dict[str, LawFit]
    chosen: str
    in_robot: str  # Best law that a robot file supports
    notes: tuple[Finding, ...]

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        first, best = self.laws["one time constant"], self.laws[self.chosen]
        return {
            "unit": "rad/s",
            **select_fields(self, "chosen", "in_robot"),
            "before": {"model": first.name, "fit_rms": first.fit_rms, "held_out": plain(first.error)},
            "after": {"model": self.chosen, "fit_rms": best.fit_rms, "held_out": plain(best.error)},
            "candidates": plain(list(self.laws.values())),
            "notes": list(self.notes),
        }


def step_record(bench: Bench) -> StepRecord:
    """Return the step record in a file; ``DataError`` if time does not increase or the command has no steps."""
    time, command, measured = (bench.values_of_quantity(name) for name in ("time", "command", "measured"))
    back = np.flatnonzero(np.diff(time) <= 0.0)
    if back.size:
        raise DataError(
            f"{bench.path}, line {back[0] + 3}: time does not increase; sort the rows, remove repeated ones"
        )
    starts = np.concatenate(([0], np.flatnonzero(np.diff(command)) + 1, [time.size]))
    held = np.diff(starts)
    if held.size < 2 or np.median(held) < SHORTEST_STEP:
        raise DataError(
            f"{bench.path}: the command is held for {np.median(held):g} rows in {held.size} steps; needs at least two steps "
            f"of {SHORTEST_STEP} rows: step the command and wait until the speed has settled"
        )
    # The command before the record, if the rotor has already reached it, is no step.
    if abs(measured[0] - command[0]) <= 0.02 * np.ptp(command):
        starts = starts[1:] if held.size > 2 else starts
    return StepRecord(path=bench.path, time=time, command=command, measured=measured, starts=starts)


def difference_to_command_after_step(error: float, tau: float, slew: float, since: Array) -> Array:
    """Return the remaining speed error [rad/s] at times ``since`` [s] after a step, (T,): a ramp, then an exponential.

    It solves ``e' = -min(|e| / tau, slew) sign(e)`` from ``error``, and is constant before the step.

    Source:
        Derived: the ramp ends where ``|e| = slew tau``; from there it is a first-order lag.
    """
    size = abs(error)
    ramp = max(size / slew - tau, 0.0)
    decay = min(size, slew * tau) * np.exp(-np.maximum(since - ramp, 0.0) / tau)
    return np.sign(error) * np.where(since < 0.0, size, np.where(since < ramp, size - slew * since, decay))


def speed_of_law(record: StepRecord, params: dict[str, float]) -> Array:
    """Return the speed [rad/s] that a law predicts from the commands and the first measured speed, (T,)."""
    shared = params.get("tau", 0.0)
    delay, speed = params.get("delay", 0.0), record.measured.copy()
    level, edges = float(record.measured[record.starts[0]]), record.starts
    for start, stop in pairwise(edges):
        goal = float(record.command[start])
        way = "up" if goal > level else "down"
        tau, slew = params.get(f"tau_{way}", shared), params.get(f"slew_{way}", NO_LIMIT)
        end = record.time[min(stop, record.time.size - 1)]
        since = np.append(record.time[start:stop], end) - record.time[start] - delay
        course = goal - difference_to_command_after_step(goal - level, tau, slew, since)
        speed[start:stop], level = course[:-1], float(course[-1])
    return speed


def fit_steps(records: Sequence[StepRecord]) -> StepFit:
    """Return the fits of all laws to all steps, with cross-validation errors over steps."""
    rises = np.concatenate([np.diff(record.levels) > 0.0 for record in records])
    counts = {"rising": int(rises.sum()), "falling": int((~rises).sum())}
    names, notes = list(LAWS), list[Finding]()
    if min(counts.values()) < 2:
        names = ["one time constant"]
        notes.append(Finding("few_steps", "", counts))
    laws = {name: _fit_law(name, records) for name in names}
    errors = {name: law.held_out_rms for name, law in laws.items()}
    terms = {name: len(params) for name, params in LAWS.items()}
    tau = min(p.value for law in laws.values() for n, p in law.params.items() if n.startswith("tau"))
    sample = float(np.median(np.concatenate([np.diff(record.time) for record in records])))
    if tau < 1.5 * sample:
        notes.append(Finding("rows_far_apart", "", {"step_s": sample}))
    chosen = smallest_good_candidate(errors, terms)
    in_robot = smallest_good_candidate({name: errors[name] for name in ROBOT_LAWS if name in laws}, terms)
    return StepFit(records=tuple(records), laws=laws, chosen=chosen, in_robot=in_robot, notes=tuple(notes))


def _fit_law(name: str, records: Sequence[StepRecord]) -> LawFit:
    labels = LAWS[name]
    start, low, high = (np.array(column) for column in zip(*(BOUNDS[label] for label in labels), strict=True))
    measured = np.concatenate([record.measured[record.starts[0] :] for record in records])
    # An unreached limit has zero gradient, so start where the largest step reaches it.
    for place, label in enumerate(labels):
        if label.startswith("slew"):
            asked = max(largest_step(record, label.removeprefix("slew_")) for record in records) / BOUNDS["tau"][0]
            start[place] = np.clip(0.5 * asked, 2.0 * low[place], 0.5 * high[place])

    def predict(values: Array) -> Array:
        params = dict(zip(labels, values, strict=True))
        return np.concatenate([speed_of_law(record, params)[record.starts[0] :] for record in records])

    begins = np.concatenate([np.isin(np.arange(r.starts[0], r.time.size), r.starts) for r in records])
    law = fit_law(name, labels, predict, measured, (start, low, high), begins.cumsum(dtype=np.int64))
    return replace(law, params=_bound_slew_limit(law.params, records))


def _bound_slew_limit(params: dict[str, Estimate], records: Sequence[StepRecord]) -> dict[str, Estimate]:
    """Return the parameters; a slew limit that no step reaches gets the required rate as its lower bound."""
    bounds = dict(params)
    for way in (way for way in ("up", "down") if f"slew_{way}" in params):
        tau = params.get(f"tau_{way}") or params["tau"]
        asked = max(largest_step(record, way) for record in records) / tau.value
        slew = params[f"slew_{way}"]
        if slew.high >= asked or slew.value >= asked:
            low = asked if slew.value >= asked else slew.low
            bounds[f"slew_{way}"] = Estimate(value=slew.value, low=low, high=BOUNDS[f"slew_{way}"][2])
    return bounds


def largest_step(record: StepRecord, way: str) -> float:
    """Return the largest step up or down in a record [rad/s]; 0 without one."""
    return float(np.max(np.diff(record.levels) * (1.0 if way == "up" else -1.0), initial=0.0))
