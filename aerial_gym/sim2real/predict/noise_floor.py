"""The noise floor: how small a residual could be if the model were perfect.

Sensor noise is white, so its level shows where the vehicle hardly moves: above the band of the comparison. There the
spectrum of the residual is fitted by a level, and a part that grows with the square of the frequency (a differentiated
signal); both are carried down through the low-pass. Vibration above the band makes the floor too high, never too low, and so
does a log that is too slow to tell the level from the growth.
Neither falls: where the spectrum does, a filter of the sensor has taken the noise away, and lines from there on do not count.
What rounding adds is not white where a signal stays between two values of its log: it is seen by rounding anew.
Letters: C channels.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage
from scipy.optimize import nnls

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass, lowpass_gain, welch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.rotor_estimate import RotorEstimate, as_measured, estimate_rotors
from aerial_gym.sim2real.predict.tolerances import Tolerances

WIDE_BAND = 0.4
"""The residual is taken up to this share of the rate,"""

FIT_FROM = 1.5
"""and fitted from this multiple of the bandwidth"""

FIT_TO = 0.32
"""to this share of the rate,"""

FIT_FROM_AT_LATEST = 0.7
"""but at least from this share of that, for a log may be slow for its band,"""

CLEAR_OF_BAND = 1.1
"""and never from below this multiple of the bandwidth."""

NARROW = 2.0
"""Lines whose highest frequency is less than this multiple of the lowest do not tell a level from growth: all is level."""

NARROW_READING = 3.0
"""The same for what a sensor reads itself, whose noise does not grow."""

FALLEN = 0.25
"""A spectrum below this share of where the fit begins has been filtered."""

BAND_RATIO = 1.6
"""Width of the bands in which it is averaged to tell."""

SEGMENT_S = 2.0
"""Length of a segment of Welch's spectrum [s]."""

LOGS = 4
"""How often a log is rounded anew."""

FEWEST_LINES = 4
"""Fewer spectral lines than this give no floor."""


def noise_floor(
    robot: RobotCfg, flights: Sequence[Flight], params: ModelParams, channels: Sequence[Channel], *, bandwidth: float
) -> Array | None:
    """Return the floor (rms) of each channel below ``bandwidth`` [Hz], (C,); None where every log is too slow to tell."""
    return of_all_flights([floor_of_flight(robot, flight, params, channels, bandwidth) for flight in flights])


def of_all_flights(floors: Sequence[Array | None]) -> Array | None:
    """Return the floor of flights whose own ones are known, each (C,); None if there are none."""
    known = [floor for floor in floors if floor is not None]
    return np.sqrt(np.mean(np.square(known), axis=0)) if known else None


def floor_of_flight(
    robot: RobotCfg, flight: Flight, params: ModelParams, channels: Sequence[Channel], bandwidth: float
) -> Array | None:
    """Return the floor (rms) of each channel of one flight, (C,); None where its log is too slow to tell.

    The level is that of a prediction from measured rotor speeds. Of its noise N a prediction from expected ones has the share
    s of motion, and differs from it by ``(1 - s)² (N + S) = (1 - s) N``: what the two differ by is taken off, as far as the
    noise of what is predicted allows. What rounding leaves in the band beyond that level is added.
    """
    readings, rate = [is_reading(channel, flight) for channel in channels], flight.rate
    as_logged = wide_predictor(robot, [flight], channels, [as_measured(flight)])
    rows = longest_flight(flight, as_logged.times[0], bandwidth)
    floor = floor_of_columns(as_logged.residuals(params)[0][rows], rate, bandwidth, readings)
    expected = estimate_rotors(robot, [flight], bandwidth)
    if floor is None:
        return None
    slow = square_of_slow_rounding(robot, flight, params, channels, bandwidth)
    if expected[0] is None:
        return np.sqrt(floor**2 + slow)
    quiet = wide_predictor(robot, [flight], channels, expected)
    apart = (as_logged.predict(params)[0] - quiet.predict(params)[0])[rows]
    least = floor_of_columns(as_logged.measured[0][rows], rate, bandwidth, readings)
    assert least is not None
    left = floor**2 - (lowpass(apart, rate, bandwidth) ** 2).mean(axis=0)
    return np.sqrt(np.maximum(left, np.minimum(floor, least) ** 2) + slow)


def square_of_slow_rounding(
    robot: RobotCfg, flight: Flight, params: ModelParams, channels: Sequence[Channel], bandwidth: float
) -> Array:
    """Return the mean square of what rounding leaves of each channel in the band, and that above it does not tell, (C,).

    From the difference between the residuals of two logs, of which one is the other one rounded.
    """
    given = {name: getattr(flight, name) for name in ("rotor_speed", "rotor_command", "specific_force", "ang_vel")}
    flown = slice(None) if flight.on_ground is None else ~flight.on_ground
    logs = {name: rounded_anew(v, flight.rate, bandwidth, flown) for name, v in given.items() if v is not None}
    flights = [replace(flight, **dict(zip(logs, log, strict=True))) for log in zip(*logs.values(), strict=True)]
    predictor = wide_predictor(robot, flights, channels, [as_measured(log) for log in flights])
    rows = longest_flight(flight, predictor.times[0], bandwidth)
    readings, squares = [is_reading(channel, flight) for channel in channels], []
    plain, *noisy = predictor.residuals(params)
    for residual in noisy:
        apart = (residual - plain)[rows]
        told = floor_of_columns(apart, flight.rate, bandwidth, readings)
        assert told is not None
        squares.append((lowpass(apart, flight.rate, bandwidth) ** 2).mean(axis=0) - told**2)
    return np.maximum(np.mean(squares, axis=0), 0.0)


def rounded_anew(values: Array, rate: float, bandwidth: float, rows: slice | Flags) -> list[Array]:
    """Return a signal, and it as ``LOGS`` logs with steps as large as those of a log would hold it, (T, K) each.

    The signal moves in the band as the logged values (T, K) do. Above it is noise, as much as they have beyond that of
    rounding, a twelfth of a squared step: what scatters over several steps is rounded to another one each time. The steps are
    those between the values that the log has of a column in ``rows``, and the noise is that in them; each of the other logs has
    its values elsewhere between them, for in its own the signal stays on one.
    """
    slow, random = lowpass(values, rate, bandwidth), np.random.default_rng(0)
    logs = np.empty((1 + LOGS, *values.shape))
    for column, known in enumerate(map(np.unique, values[rows].T)):
        places, moves = np.arange(known.size), slow[:, column]
        step = np.interp(moves, known[1:], np.diff(known)) if known.size > 1 else 0.0
        noise = np.mean((values[:, column] - moves)[rows] ** 2) - np.mean(np.square(step)) / 12.0
        signal_ = moves + np.sqrt(max(noise, 0.0)) * random.standard_normal(moves.size)
        logs[0, :, column] = np.clip(signal_, known[0], known[-1])
        place = np.interp(logs[0, :, column], known, places)
        for log, phase in zip(logs[1:], random.random(LOGS), strict=True):
            log[:, column] = np.interp(np.round(place - phase) + phase, places, known)
    return list(logs)


def wide_predictor(
    robot: RobotCfg, flights: Sequence[Flight], channels: Sequence[Channel], rotors: Sequence[RotorEstimate | None]
) -> Predictor:
    """Return what predicts every row of flights of one rate up to frequencies above the band of a comparison.

    ``rotors`` are the rotor speeds of each from which it is predicted.
    """
    return Predictor(
        robot,
        flights,
        bandwidth=WIDE_BAND * flights[0].rate,
        channels=channels,
        tolerances=Tolerances(),
        every_row=True,
        rotors=rotors,
    )


def floor_of_columns(values: Array, rate: float, bandwidth: float, readings: Sequence[bool]) -> Array | None:
    """Return how large (rms) the noise of columns is below a bandwidth [Hz], (K,); None where the log is too slow to tell.

    Args:
        values: Every row, below ``WIDE_BAND`` of the rate, (T, K).
        rate: Rows per second.
        bandwidth: Of the comparison [Hz].
        readings: Whether each is what a sensor reads itself, whose noise does not grow with frequency.
    """
    wide, length = WIDE_BAND * rate, min(values.shape[0], round(SEGMENT_S * rate))
    if length < 2:
        return None
    frequency, density = welch(values, rate, length)
    low = max(min(FIT_FROM * bandwidth, FIT_FROM_AT_LATEST * FIT_TO * rate), CLEAR_OF_BAND * bandwidth)
    chosen = (frequency >= low) & (frequency <= FIT_TO * rate)
    if chosen.sum() < FEWEST_LINES:
        return None
    flat = density[chosen] / lowpass_gain(frequency[chosen], wide)[:, None] ** 2
    square = (2.0 * np.pi * frequency) ** 2
    below = lowpass_gain(frequency, bandwidth) ** 2
    spacing = frequency[1] - frequency[0]
    floors = []
    for reading, line in zip(readings, flat.T, strict=True):
        if not line.any():
            floors.append(0.0)
            continue
        own = slice(_unfiltered(frequency[chosen], line))
        lines = frequency[chosen][own]
        narrow = lines[-1] < (NARROW_READING if reading else NARROW) * lines[0]
        level, growth = (line[own].mean(), 0.0) if narrow else _level_and_growth(line[own], square[chosen][own])
        floors.append(np.sqrt((below * (level + growth * square)).sum() * spacing))
    return np.array(floors)


def is_reading(channel: Channel, flight: Flight) -> bool:
    """Return whether a sensor reads what a channel compares, and not its integral."""
    return channel.kind == "rotor_speed" or (channel.kind == "specific_force" and flight.accelerometer)


def longest_flight(flight: Flight, time: Array, bandwidth: float) -> slice:
    """Return the rows at these times [s] of the longest span between touches of the ground; all if the vehicle never stands."""
    if flight.on_ground is None:
        return slice(None)
    near = 2 * round(flight.rate / bandwidth) + 1
    stood = ndimage.maximum_filter1d(flight.on_ground, near)[np.round(time * flight.rate).astype(int)]
    edges = np.flatnonzero(np.diff(np.concatenate(([True], stood, [True]))))
    if edges.size == 0:
        return slice(0, 0)
    longest = int(np.argmax(edges[1::2] - edges[::2]))
    return slice(int(edges[2 * longest]), int(edges[2 * longest + 1]))


def _unfiltered(frequency: Array, density: Array) -> int:
    """Return how many lines of a spectrum lie below where it has fallen, at least ``FEWEST_LINES``."""
    band = np.floor(np.log(frequency / frequency[0]) / np.log(BAND_RATIO)).astype(int)
    mean = np.bincount(band, weights=density) / np.maximum(np.bincount(band), 1)
    fallen = np.flatnonzero((mean < FALLEN * mean[0]) & (np.bincount(band) > 0))
    return max(int(np.sum(band < fallen[0])), FEWEST_LINES) if fallen.size else frequency.size


def _level_and_growth(density: Array, square: Array) -> tuple[float, float]:
    """Return a and b >= 0 of ``a + b (2 pi f)²``, fitted with the relative scatter that spectral lines have."""
    weight = 1.0 / np.maximum(density, 1e-300)
    for _ in range(5):
        columns = np.stack((np.ones_like(square), square), axis=1) * weight[:, None]
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        (level, growth), _ = nnls(columns / size, density * weight)
        level, growth = level / size[0], growth / size[1]
        weight = 1.0 / np.maximum(level + growth * square, 1e-300)
    return float(level), float(growth)
