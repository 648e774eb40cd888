"""What kind of structure a remaining residual has: does it follow place, time, or a frequency of its own?

Each explanation is fitted on all flights but one and judged on that one, so that only what repeats counts.
Letters: T rows, C channels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from aerial_gym.sim2real.flights import Flight
from aerial_gym.sim2real.prediction import Channel

Array = NDArray[np.float64]

LEAST_SHARE = 0.3
"""A kind is named if it explains this share of the residual's variance on flights left out."""

SEGMENT_S = 8.0
OWN_MOTION = 0.5
"""A line is no structure of its own if the motion of the flights has this share of it."""

LINE_WIDTH = 2
"""A spectral line spreads over this many neighbours on each side."""


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Kind of what remains."""

    kind: str = "none"
    """position, periodic, time or none."""

    freq_hz: float | None = None
    """Of a periodic residual [Hz]."""

    channel: str | None = None
    """Where it is strongest; forces in world axes for position."""

    share: float = 0.0
    """Share of the variance there that it explains on flights left out."""

    def as_mapping(self) -> dict[str, object]:
        """Return it for JSON."""
        return {"kind": self.kind, "freq_hz": self.freq_hz, "channel": self.channel, "share": round(self.share, 3)}


def find_structure(
    flights: Sequence[Flight],
    times: Sequence[Array],
    residuals: Sequence[Array],
    channels: Sequence[Channel],
    chosen: Sequence[int],
) -> Structure:
    """Return the strongest kind of structure in the chosen channels; ``none`` unless two flights agree on it."""
    if len(flights) < 2 or not chosen:
        return Structure()
    world = [world_forces(f, t, r, channels) for f, t, r in zip(flights, times, residuals, strict=True)]
    found = [Structure()]
    place = [_place_features(f, t) for f, t in zip(flights, times, strict=True)]
    motion = [_motion(f, t) for f, t in zip(flights, times, strict=True)]
    clock = [np.stack((t, t**2), axis=1) for t in times]
    for index in chosen:
        name = channels[index].name
        if all(part is not None for part in place):
            columns = _spread([part for part in place if part is not None])
            share = _left_out_share(columns, [w[:, index] for w in world])
            found.append(Structure(kind="position", channel=name, share=share))
        share = _left_out_share(clock, [r[:, index] for r in residuals])
        found.append(Structure(kind="time", channel=name, share=share))
        line = _common_line(times, [r[:, index] for r in residuals], motion)
        if line is not None:
            found.append(Structure(kind="periodic", channel=name, freq_hz=line[0], share=line[1]))
    best = max(found, key=lambda structure: structure.share)
    return best if best.share >= LEAST_SHARE else Structure()


def world_forces(flight: Flight, time: Array, residual: Array, channels: Sequence[Channel]) -> Array:
    """Return the residual with its forces turned into world axes, (T, C)."""
    force = [place for place, channel in enumerate(channels) if channel.kind == "specific_force"]
    if len(force) != 3:
        return residual
    rows = np.round(time * flight.rate).astype(int)
    turned = residual.copy()
    turned[:, force] = Rotation.from_quat(flight.attitude[rows]).apply(residual[:, force])
    return turned


def _place_features(flight: Flight, time: Array) -> Array | None:
    if flight.position is None:
        return None
    return flight.position[np.round(time * flight.rate).astype(int)]


def _spread(places: Sequence[Array]) -> list[Array]:
    """Return functions of place: a smooth one of height, and a paraboloid over the ground."""
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


def _left_out_share(features: Sequence[Array], values: Sequence[Array]) -> float:
    """Return the share of the variance about the mean that features explain on flights left out."""
    left = total = 0.0
    for out in range(len(values)):
        kept = [i for i in range(len(values)) if i != out]
        x, y = np.concatenate([features[i] for i in kept]), np.concatenate([values[i] for i in kept])
        centre, size = x.mean(axis=0), np.maximum(x.std(axis=0), 1e-12)
        columns = np.column_stack((np.ones(len(x)), (x - centre) / size))
        gram = columns.T @ columns + 1e-3 * len(x) * np.diag([0.0, *np.ones(x.shape[1])])
        gains = np.linalg.solve(gram, columns.T @ y)
        test = np.column_stack((np.ones(len(values[out])), np.clip((features[out] - centre) / size, -3.0, 3.0)))
        left += float(np.sum((values[out] - test @ gains) ** 2))
        total += float(np.sum((values[out] - y.mean()) ** 2))
    return 1.0 - left / max(total, 1e-300)


def _motion(flight: Flight, time: Array) -> Array:
    """Return how the vehicle moves, (T, 3 or 6): a line that is in here is the flight's own."""
    rows = np.round(time * flight.rate).astype(int)
    parts = [part[rows] for part in (flight.ang_vel, flight.lin_vel) if part is not None]
    return np.concatenate(parts, axis=1)


def _common_line(
    times: Sequence[Array], values: Sequence[Array], motion: Sequence[Array]
) -> tuple[float, float] | None:
    """Return frequency [Hz] and share of the variance of a line that every flight has and none flies; None without one."""
    rate = 1.0 / float(np.median(np.diff(times[0])))
    length = min(round(SEGMENT_S * rate), min(v.size for v in values))
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    spectra = [_relative_spectrum(v[:, None], rate, length)[:, 0] for v in values]
    inner = slice(2 * LINE_WIDTH, frequency.size - LINE_WIDTH)
    peak = int(np.argmax(np.mean(spectra, axis=0)[inner])) + 2 * LINE_WIDTH
    share = min(_line_share(spectrum, peak) for spectrum in spectra)
    flown = [[_line_share(line, peak) for line in _relative_spectrum(m, rate, length).T] for m in motion]
    own = float(np.mean(flown, axis=0).max())
    return (float(frequency[peak]), share) if share > 0.0 and own < OWN_MOTION * share else None


def _relative_spectrum(values: Array, rate: float, length: int) -> Array:
    """Return the share of the variance at each frequency, (lines, columns)."""
    _, density = signal.welch(values, rate, nperseg=length, detrend="linear", axis=0)
    return density / np.maximum(density.sum(axis=0), 1e-300)


def _line_share(spectrum: Array, peak: int) -> float:
    """Return what a line and its neighbours hold above the level around it."""
    near = spectrum[max(peak - 6 * LINE_WIDTH, 0) : peak + 6 * LINE_WIDTH + 1]
    return float((spectrum[peak - LINE_WIDTH : peak + LINE_WIDTH + 1] - np.median(near)).sum())
