"""The check of the clocks of two vehicles' logs: the time at which one feels the wake of the other. Letters: T rows."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects.air_motion import FITTED_WIDTHS
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.moments import share_of_independent_rows
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import LATE_S
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times
from aerial_gym.sim2real.statistics import chi_square_tail

OFFSETS = np.linspace(-4.0, 4.0, 801)  # Tried offsets of the second clock [s]
WIDTHS = np.geomspace(FITTED_WIDTHS[0], FITTED_WIDTHS[-1], 8)  # Tried widths of the wake [m]
INTERVAL = (
    1.92  # Fall of the log likelihood at the ends of a 95 % interval: half the chi-squared quantile of one number
)
LATE = float(
    np.hypot(2.0 * LATE_S, OFFSETS[1] - OFFSETS[0])
)  # Standard deviation of the offset by delays of sensors [s]
ONE_PEAK = 0.1  # Offsets that fit and lie this close together are one [s]: less than the passage through a wake
LEAST_ROWS = 50  # Least rows that two offsets need in common for a comparison
WAKE = "downwash"


def clock_findings(predictor: Predictor, params: ModelParams, significance: float) -> list[Finding]:
    """Return a finding on each pair of logs: the wake confirms or contradicts the common clock, or none shows it.

    The residual of the force without the wake is compared with a Gaussian wake of any width, at any offset of the clocks.
    If no wake is among the effects in ``params``, a single pair may show a residual of another shape: only contradictions
    that agree with that of another pair are left. ``significance``: largest p-value of a wake, and of another offset than
    the stated one, times the number of trials.
    """
    places = [place for place, channel in enumerate(predictor.channels) if channel.kind == "specific_force"]
    still = {name: values for name, values in params.effects.items() if EFFECTS.get(name).cause != WAKE}
    parts = dict[int, list[int]]()
    for place, flight in enumerate(predictor.flights):
        known = flight.position is not None and flight.other_position is not None
        if flight.pair is not None and known and len(places) == 3:
            parts.setdefault(flight.pair.pair, []).append(place)
    residuals, results = predictor.residuals(replace(params, effects=still)) if parts else [], list[Finding]()
    for own in parts.values():
        seen = [(predictor.flights[k], predictor.times[k], residuals[k][:, places]) for k in own]
        name = " and ".join(flight.name for flight, _, _ in seen)
        gains = log_likelihood_gains(seen)
        equal = equal_offsets(seen, float(OFFSETS[gains.argmax()]))
        results.append(_finding_on_clock(name, gains, significance, equal))
    return results if len(still) < len(params.effects) else contradictions_of_several_pairs(results)


def contradictions_of_several_pairs(findings: Sequence[Finding]) -> list[Finding]:
    """Return findings on clocks with no others left than contradictions whose interval meets that of another pair."""
    doubts = [one for one in findings if one.code == "clock_contradicted"]
    agree = [one for one in doubts if any(_offsets_meet(one, other) for other in doubts if other is not one)]
    return [one if one in agree else Finding("clock_unchecked", one.subject) for one in findings]


def _offsets_meet(first: Finding, second: Finding) -> bool:
    """Return whether the intervals of two offsets meet."""
    apart = abs(first.values["offset_s"] - second.values["offset_s"])
    return apart <= first.values["half_width_s"] + second.values["half_width_s"]


def log_likelihood_gains(seen: Sequence[tuple[Flight, Array, Array]]) -> Array:
    """Return the log likelihood that a wake gains at each of ``OFFSETS``, by flight, times [s] (T,) and residual (T, 3).

    No wake pushes upwards, so other residuals gain as much by it as by the same push downwards: the largest such gain is
    subtracted.
    """
    force = np.concatenate([part - part.mean(axis=0) for _, _, part in seen])
    projections, sizes = np.zeros((2, OFFSETS.size, WIDTHS.size))
    wakes = [_wakes_of_flight(flight, time) for flight, time, _ in seen]
    for index, offset in enumerate(OFFSETS):
        for wakes_by_offset, (_, _, part) in zip(wakes, seen, strict=True):
            projections[index], sizes[index] = np.add(
                (projections[index], sizes[index]), _wake_sums(part, wakes_by_offset(offset)[0])
            )
    sizes = np.maximum(sizes, 1e-9)
    down, up = (np.maximum(sign * projections, 0.0) ** 2 / sizes for sign in (1.0, -1.0))  # fall of the sum of squares
    left = float((force**2).sum()) - float(down.max())
    share = float(np.mean([share_of_independent_rows(part).mean() for _, _, part in seen]))
    return 0.5 * share * force.size * np.maximum(down.max(axis=1) - float(up.max()), 0.0) / left


def _wakes_of_flight(flight: Flight, time: Array) -> Callable[[float], tuple[Array, Flags]]:
    """Return the function from a clock offset [s] to Gaussian wakes of unit force, (T, 3, widths), and the rows with a known
    other vehicle, (T,)."""
    rows = rows_at_times(flight, time)
    assert flight.pair is not None
    assert flight.position is not None
    assert flight.other_position is not None
    other_position, own = flight.other_position.T, flight.position[rows]
    down = Rotation.from_quat(flight.attitude[rows]).apply([0.0, 0.0, -1.0], inverse=True)
    sign = 1.0 if flight.pair.vehicle else -1.0  # the other log is the second one for the first vehicle

    def wakes_by_offset(offset: float) -> tuple[Array, Flags]:
        other = np.stack(
            [np.interp(time + sign * offset, flight.time, one, np.nan, np.nan) for one in other_position], axis=1
        )
        away = other - own
        acts = (away[:, 2] > 0.0)[:, None]  # False where the other vehicle is unknown
        square = np.where(acts, (away[:, :2] ** 2).sum(axis=1)[:, None], 0.0)
        wakes = (acts * np.exp(-0.5 * square / WIDTHS**2))[:, None] * down[:, :, None]
        return wakes, ~np.isnan(other).any(axis=1)

    return wakes_by_offset


def _wake_sums(part: Array, wakes: Array) -> Array:
    """Return products of a residual (T, 3) with wakes (T, 3, widths), and their squares, about means, (2, widths)."""
    wakes = wakes - wakes.mean(axis=0)
    return np.stack((np.einsum("tc,tcw->w", part - part.mean(axis=0), wakes), (wakes**2).sum(axis=(0, 1))))


def equal_offsets(seen: Sequence[tuple[Flight, Array, Array]], best: float) -> Array:
    """Return the offsets [s] whose wake fits as well as that of the best one, on the rows known with both."""
    functions = [_wakes_of_flight(flight, time) for flight, time, _ in seen]
    shares = [float(share_of_independent_rows(part).mean()) for _, _, part in seen]
    own, results = [wakes_by_offset(best) for wakes_by_offset in functions], list[float]()
    for offset in OFFSETS[::2]:
        sums, power, rows, share = np.zeros((2, 2, WIDTHS.size)), 0.0, 0, list[float]()
        for (_, _, part), wakes_by_offset, (wakes, known), share_of_rows in zip(
            seen, functions, own, shares, strict=True
        ):
            other, also = wakes_by_offset(float(offset))
            both = known & also
            if both.sum() < LEAST_ROWS:
                continue
            sums += np.stack([_wake_sums(part[both], each[both]) for each in (wakes, other)])
            power += float(((part[both] - part[both].mean(axis=0)) ** 2).sum())
            rows += 3 * int(both.sum())
            share.append(share_of_rows)
        fall = (np.maximum(sums[:, 0], 0.0) ** 2 / np.maximum(sums[:, 1], 1e-9)).max(axis=1)
        if rows and 0.5 * np.mean(share) * rows * (fall[0] - fall[1]) < INTERVAL * (power - fall[0]):
            results.append(float(offset))
    return np.array(results)


def _finding_on_clock(name: str, gains: Array, significance: float, equal: Array | None = None) -> Finding:
    """Return the finding on the clocks of a pair by the gains at ``OFFSETS``, and the offsets that fit as well as the best.

    If several separate offsets fit equally, as with periodic passes, or those at an end of the range, none is stated.
    """
    best, stated = int(gains.argmax()), int(np.abs(OFFSETS).argmin())
    near = OFFSETS[gains > gains[best] - INTERVAL]
    alike = np.concatenate((near, near[:0] if equal is None else equal))
    is_one = 0 < best < gains.size - 1 and float(np.ptp(alike)) <= float(np.ptp(near)) + ONE_PEAK
    values = {"offset_s": float(OFFSETS[best]), "half_width_s": 0.5 * float(near[-1] - near[0])}
    trials = gains.size * WIDTHS.size
    other = gains.size * chi_square_tail(2.0 * float(gains[best] - gains[stated]), 1)
    late = chi_square_tail(
        (values["offset_s"] / LATE) ** 2, 1
    )  # both logs' positions and forces come late by themselves
    if trials * chi_square_tail(2.0 * float(gains[best]), 1) < significance > max(other, late):
        return Finding("clock_contradicted", name, values) if is_one else Finding("clock_undecided", name)
    seen = trials * chi_square_tail(2.0 * float(gains[stated]), 1) < significance
    return Finding("clock_confirmed", name, values) if seen and is_one else Finding("clock_unchecked", name)
