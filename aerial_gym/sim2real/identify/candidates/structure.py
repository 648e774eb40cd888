"""Detection of structure in a residual: dependence on place, heading and so on, or a spectral line.

Only structure counts that repeats on a flight left out of its fit. Letters: T rows, C channels, F flights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.recording import flight_numbers
from aerial_gym.sim2real.logs.signals import welch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times

LEAST_SHARE = 0.3  # Least explained share of the variance on left-out flights
LEAST_FLIGHTS = 2  # Least number of flights that a fit of the others predicts better than their mean

SEGMENT_S = 8.0
OWN_MOTION = 0.5  # Largest share of a line in the motion, over that in the residual, not caused by motion
LINE_WIDTH = 2  # Half width of a spectral line in bins


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Structure of a residual."""

    kind: str = "none"  # position, heading, velocity, voltage, time, periodic or none
    freq_hz: float | None = None  # Frequency of a periodic residual [Hz]
    channel: str | None = None  # Channel of the strongest structure; forces are in world axes for position and heading
    share: float = 0.0  # Explained share of its variance on left-out flights

    def as_mapping(self) -> dict[str, object]:
        """Return the values for JSON."""
        return {"kind": self.kind, "freq_hz": self.freq_hz, "channel": self.channel, "share": round(self.share, 3)}


IN_WORLD = ("position", "heading")  # Kinds whose forces are evaluated in world axes


def find_structure(
    flights: Sequence[Flight], times: Sequence[Array], residuals: Sequence[Array], channels: Sequence[Channel],
    chosen: Sequence[int],
) -> Structure:  # fmt: skip
    """Return the strongest structure in the chosen channels; ``none`` for a single flight or a small share."""
    numbers = flight_numbers(flights)
    if numbers.max(initial=-1) + 1 < LEAST_FLIGHTS or not chosen:
        return Structure()
    results = [Structure()]
    for kind, columns in structure_features(flights, times).items():
        left, total = _left_out_squares(columns, rotate_residuals(kind, flights, times, residuals, channels), numbers)
        shares = 1.0 - left.sum(axis=0) / np.maximum(total.sum(axis=0), 1e-300)
        shares[(left < total).sum(axis=0) < LEAST_FLIGHTS] = 0.0
        best = max(chosen, key=lambda index: shares[index])
        results.append(Structure(kind=kind, channel=channels[best].name, share=float(shares[best])))
    lines = CommonLines(times, [motion_features(f, t) for f, t in zip(flights, times, strict=True)])
    for index in chosen:
        line = lines.strongest_line([r[:, index] for r in residuals])
        if line is not None:
            results.append(Structure(kind="periodic", channel=channels[index].name, freq_hz=line[0], share=line[1]))
    best = max(results, key=lambda structure: structure.share)
    return best if best.share >= LEAST_SHARE else Structure()


def rotate_residuals(
    kind: str, flights: Sequence[Flight], times: Sequence[Array], residuals: Sequence[Array],
    channels: Sequence[Channel],
) -> list[Array]:  # fmt: skip
    """Return the residuals in the axes that suit a kind of structure, (T, C) each."""
    if kind not in IN_WORLD:
        return list(residuals)
    return [rotate_forces_to_world(f, t, r, channels) for f, t, r in zip(flights, times, residuals, strict=True)]


def force_channel_indices(channels: Sequence[Channel]) -> tuple[int, ...]:
    """Return the indices of the specific forces x, y and z; empty if one is missing."""
    results = tuple(place for place, channel in enumerate(channels) if channel.kind == "specific_force")
    return results if len(results) == 3 else ()


def rotate_forces_to_world(flight: Flight, time: Array, residual: Array, channels: Sequence[Channel]) -> Array:
    """Return the residual with specific forces rotated to world axes, (T, C)."""
    force = list(force_channel_indices(channels))
    if not force:
        return residual
    turned = residual.copy()
    turned[:, force] = Rotation.from_quat(flight.attitude[rows_at_times(flight, time)]).apply(residual[:, force])
    return turned


def structure_features(flights: Sequence[Flight], times: Sequence[Array]) -> dict[str, list[Array]]:
    """Return candidate regressors by kind, (T, any) of each flight, for the kinds that all flights have."""
    pairs = [(flight, rows_at_times(flight, time)) for flight, time in zip(flights, times, strict=True)]
    results = {"time": [np.stack((time, time**2), axis=1) for time in times]}
    if all(flight.position is not None for flight in flights):
        places = [flight.position[rows] for flight, rows in pairs if flight.position is not None]
        results["position"] = _place_features(places)
    turns = [Rotation.from_quat(flight.attitude[rows]) for flight, rows in pairs]
    if not any(flight.attitude_integrated for flight in flights):  # an integrated gyro has no heading reference
        ahead = [np.arctan2(*turn.apply([1.0, 0.0, 0.0])[:, 1::-1].T) for turn in turns]
        results["heading"] = [np.stack([f(n * yaw) for n in (1, 2) for f in (np.cos, np.sin)], axis=1) for yaw in ahead]
    if all(flight.lin_vel is not None for flight in flights):
        velocities = [flight.lin_vel[rows] for flight, rows in pairs if flight.lin_vel is not None]
        speeds = [turn.apply(v, inverse=True) for turn, v in zip(turns, velocities, strict=True)]
        results["velocity"] = [np.concatenate((v, v * np.abs(v), v**2), axis=1) for v in speeds]
    if all(flight.battery is not None for flight in flights):
        volts = [flight.battery[rows, None] for flight, rows in pairs if flight.battery is not None]
        results["voltage"] = [np.concatenate((v, v**2), axis=1) for v in volts]
    return results


def _place_features(places: Sequence[Array]) -> list[Array]:
    """Return regressors of place: a spline of height and quadratic polynomials of x and y."""
    height = np.concatenate([p[:, 2] for p in places])
    knots = np.unique(np.quantile(height, np.linspace(0.0, 1.0, 5)))
    if knots.size < 3 or np.ptp(height) < 1e-6:
        return [np.column_stack((p[:, :2], p[:, :2] ** 2)) for p in places]
    full = np.concatenate(([knots[0]] * 2, knots, [knots[-1]] * 2))
    parts = []
    for p in places:
        z = np.clip(p[:, 2], knots[0], knots[-1])
        spline = BSpline.design_matrix(z, full, 2).toarray()[:, 1:]
        parts.append(np.column_stack((spline, p[:, :2], p[:, :2] ** 2, p[:, 0] * p[:, 1])))
    return parts


def _left_out_squares(features: Sequence[Array], values: Sequence[Array], numbers: Indices) -> tuple[Array, Array]:
    """Return the squared residuals of left-out flights with features, and about the other flights' mean, (F, C) each.

    ``numbers``: number of the flight of each log.
    """
    left, total = list[Array](), list[Array]()
    for out in range(len(values)):
        kept = np.flatnonzero(numbers != numbers[out])
        x, y = np.concatenate([features[i] for i in kept]), np.concatenate([values[i] for i in kept])
        centre, size = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-12)
        columns = np.column_stack((np.ones(len(x)), (x - centre) / size))
        gram = columns.T @ columns + 1e-3 * len(x) * np.diag([0.0, *np.ones(x.shape[1])])
        gains = np.linalg.solve(gram, columns.T @ y)
        test = np.column_stack((np.ones(len(values[out])), np.clip((features[out] - centre) / size, -3.0, 3.0)))
        left.append(np.sum((values[out] - test @ gains) ** 2, axis=0))
        total.append(np.sum((values[out] - y.mean(axis=0)) ** 2, axis=0))
    groups = [np.flatnonzero(numbers == number) for number in np.unique(numbers)]
    sums = [np.stack([np.stack(part)[own].sum(axis=0) for own in groups]) for part in (left, total)]
    return sums[0], sums[1]


def motion_features(flight: Flight, time: Array) -> Array:
    """Return angular and linear velocity, (T, 3 or 6), to reject lines that the motion causes."""
    rows = rows_at_times(flight, time)
    parts = [part[rows] for part in (flight.ang_vel, flight.lin_vel) if part is not None]
    return np.concatenate(parts, axis=1)


class CommonLines:
    """Search for spectral lines that all flights have but their motion has not."""

    def __init__(self, times: Sequence[Array], motion: Sequence[Array]) -> None:
        """Store the row times of each flight [s], (T,), and its motion, (T, any)."""
        self._rate = 1.0 / float(np.median(np.diff(times[0])))
        self._length = min(round(SEGMENT_S * self._rate), min(time.size for time in times))
        self._frequency = np.fft.rfftfreq(self._length, 1.0 / self._rate)
        common = min(m.shape[1] for m in motion)  # a flight may lack the velocity, whose columns come last
        self._flown = [self._power_shares(m[:, :common]) for m in motion]

    def strongest_line(self, values: Sequence[Array]) -> tuple[float, float] | None:
        """Return frequency [Hz] and variance share of the strongest line in values (T,); None without one."""
        spectra = [self._power_shares(v[:, None]) for v in values]
        inner = slice(2 * LINE_WIDTH, self._frequency.size - LINE_WIDTH)
        peak = int(np.argmax(np.mean(spectra, axis=0)[inner])) + 2 * LINE_WIDTH
        share = min(float(_line_share(spectrum, peak)[0]) for spectrum in spectra)
        if share <= 0.0:
            return None
        own = float(np.mean([_line_share(flown, peak) for flown in self._flown], axis=0).max())
        return (float(self._frequency[peak]), share) if own < OWN_MOTION * share else None

    def _power_shares(self, values: Array) -> Array:
        """Return the normalised power spectrum, (lines, columns)."""
        _, density = welch(values, self._rate, self._length)
        return density / np.maximum(density.sum(axis=0), 1e-300)


def _line_share(spectra: Array, peak: int) -> Array:
    """Return the power of a line above the surrounding median, (columns,), in spectra (lines, columns)."""
    near = spectra[max(peak - 6 * LINE_WIDTH, 0) : peak + 6 * LINE_WIDTH + 1]
    return (spectra[peak - LINE_WIDTH : peak + LINE_WIDTH + 1] - np.median(near, axis=0)).sum(axis=0)
