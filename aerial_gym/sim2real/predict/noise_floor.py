"""The noise floor: the RMS residual that a perfect model would leave.

Sensor noise is white, so its level is measured above the comparison band: a constant plus a term in the squared frequency,
for a differentiated signal, is fitted to the residual's spectrum and extrapolated down. Vibration there makes the floor too
high. Lines beyond a fall by the sensor's own low-pass are ignored. Rounding noise in the band comes from rounded simulated
signals. Letters: C channels.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.arrays import Array, Flags, true_spans
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass, lowpass_gain, welch
from aerial_gym.sim2real.predict.channels import Channel
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rows.dataset import rows_at_times
from aerial_gym.sim2real.predict.rows.rotor_estimate import RotorEstimate, estimate_as_measured, estimate_rotors
from aerial_gym.sim2real.predict.tolerances import Tolerances

WIDE_BAND = 0.4  # Bandwidth of the residual's spectrum as a share of the rate
FIT_FROM = 1.5  # Lower end of the fit in comparison bandwidths
FIT_TO = 0.32  # Upper end of the fit as a share of the rate
FIT_FROM_AT_LATEST = 0.7  # Largest lower end of the fit as a share of its upper end, for slow logs
CLEAR_OF_BAND = 1.1  # Least lower end of the fit in comparison bandwidths, whatever the rate
NARROW = 2.0  # Least frequency ratio of lines that separate both terms; below it only the constant is fitted
NARROW_READING = 3.0  # The same ratio for direct sensor readings, whose noise does not grow with frequency
FALLEN = 0.25  # Share of the first band's density below which a band counts as low-passed
BAND_RATIO = 1.6  # Frequency ratio of the bands over which the spectrum is averaged for this
SEGMENT_S = 2.0  # Length of a segment of Welch's spectrum [s]
LOGS = 4  # Number of simulated roundings of a log
FEWEST_LINES = 4  # Least number of spectral lines of a fit


def noise_floor(
    robot: RobotCfg, flights: Sequence[Flight], params: ModelParams, channels: Sequence[Channel], *, bandwidth: float
) -> Array | None:
    """Return the noise floor (RMS) of each channel below ``bandwidth`` [Hz], (C,); None if every log is too slow."""
    return rms_of_noise_floors(
        [noise_floor_of_flight(robot, flight, params, channels, bandwidth) for flight in flights]
    )


def rms_of_noise_floors(floors: Sequence[Array | None]) -> Array | None:
    """Return the RMS of the known floors of several flights, (C,); None if there are none."""
    known = [floor for floor in floors if floor is not None]
    return np.sqrt(np.mean(np.square(known), axis=0)) if known else None


def noise_floor_of_flight(
    robot: RobotCfg, flight: Flight, params: ModelParams, channels: Sequence[Channel], bandwidth: float
) -> Array | None:
    """Return the noise floor (RMS) of each channel of one flight, (C,); None if the log is too slow.

    A prediction from measured rotor speeds and one from expected speeds, which keep the share s of the noise N, differ by
    ``(1 - s)² (N + S) = (1 - s) N``. This is subtracted, down to the noise of the channel itself; rounding in the band is
    added.
    """
    readings, rate = [is_sensor_reading(channel, flight) for channel in channels], flight.rate
    as_logged = wide_band_predictor(robot, [flight], channels, [estimate_as_measured(flight)])
    rows = longest_airborne_rows(flight, as_logged.times[0], bandwidth)
    floor = noise_floor_of_columns(as_logged.residuals(params)[0][rows], rate, bandwidth, readings)
    expected = estimate_rotors(robot, [flight], bandwidth)
    if floor is None:
        return None
    slow = mean_square_of_rounding(robot, flight, params, channels, bandwidth)
    if expected[0] is None:
        return np.sqrt(floor**2 + slow)
    quiet = wide_band_predictor(robot, [flight], channels, expected)
    apart = (as_logged.predict(params)[0] - quiet.predict(params)[0])[rows]
    least = noise_floor_of_columns(as_logged.measured[0][rows], rate, bandwidth, readings)
    assert least is not None
    left = floor**2 - (lowpass(apart, rate, bandwidth) ** 2).mean(axis=0)
    return np.sqrt(np.maximum(left, np.minimum(floor, least) ** 2) + slow)


def mean_square_of_rounding(
    robot: RobotCfg, flight: Flight, params: ModelParams, channels: Sequence[Channel], bandwidth: float
) -> Array:
    """Return the mean square of rounding errors in the band, beyond the level seen above it, (C,), by rounded copies."""
    given = {name: getattr(flight, name) for name in ("rotor_speed", "rotor_command", "specific_force", "ang_vel")}
    excluded = flight.rows_without_comparison(0)
    flown = slice(None) if excluded is None else ~excluded
    logs = {name: simulate_rounding(v, flight.rate, bandwidth, flown) for name, v in given.items() if v is not None}
    if not any((copy != plain).any() for plain, *copies in logs.values() for copy in copies):  # finer than the noise
        return np.zeros(len(channels))
    flights = [replace(flight, **dict(zip(logs, log, strict=True))) for log in zip(*logs.values(), strict=True)]
    predictor = wide_band_predictor(robot, flights, channels, [estimate_as_measured(log) for log in flights])
    rows = longest_airborne_rows(flight, predictor.times[0], bandwidth)
    readings, squares = [is_sensor_reading(channel, flight) for channel in channels], []
    plain, *noisy = predictor.residuals(params)
    for residual in noisy:
        apart = (residual - plain)[rows]
        told = noise_floor_of_columns(apart, flight.rate, bandwidth, readings)
        assert told is not None
        squares.append((lowpass(apart, flight.rate, bandwidth) ** 2).mean(axis=0) - told**2)
    return np.maximum(np.mean(squares, axis=0), 0.0)


def simulate_rounding(values: Array, rate: float, bandwidth: float, rows: slice | Flags) -> list[Array]:
    """Return a simulated signal, and ``LOGS`` roundings of it with the step sizes of the log, (T, K) each.

    It has the logged values in the band and, above it, white noise of their variance minus that of rounding, step² / 12.
    Each rounding has a random phase, since at the log's own phase the signal would stay on one value. If most values differ,
    steps are far below the noise, and a wide space between rare values is no step: nothing is rounded.
    """
    slow, random = lowpass(values, rate, bandwidth), np.random.default_rng(0)
    logs = np.empty((1 + LOGS, *values.shape))
    for column, known in enumerate(map(np.unique, values[rows].T)):
        places, moves = np.arange(known.size), slow[:, column]
        step = np.interp(moves, known[1:], np.diff(known)) if known.size > 1 else 0.0
        noise = np.mean((values[:, column] - moves)[rows] ** 2) - np.mean(np.square(step)) / 12.0
        signal_ = moves + np.sqrt(max(noise, 0.0)) * random.standard_normal(moves.size)
        logs[:, :, column] = np.clip(signal_, known[0], known[-1])
        if 2 * known.size > moves[rows].size:
            continue
        place = np.interp(logs[0, :, column], known, places)
        for log, phase in zip(logs[1:], random.random(LOGS), strict=True):
            log[:, column] = np.interp(np.round(place - phase) + phase, places, known)
    return list(logs)


def wide_band_predictor(
    robot: RobotCfg, flights: Sequence[Flight], channels: Sequence[Channel], rotors: Sequence[RotorEstimate | None]
) -> Predictor:
    """Return a predictor of every row of flights with one rate, beyond the comparison band, from these rotor speeds."""
    band = WIDE_BAND * flights[0].rate
    return Predictor(
        robot, flights, bandwidth=band, channels=channels, tolerances=Tolerances(), every_row=True, rotors=rotors
    )


def noise_floor_of_columns(values: Array, rate: float, bandwidth: float, readings: Sequence[bool]) -> Array | None:
    """Return the RMS noise below a bandwidth [Hz] of columns (T, K), low-passed at ``WIDE_BAND``; None if too slow.

    ``readings``: whether each column is a direct sensor reading, whose noise does not grow with frequency.
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
        own = slice(_num_unfiltered_lines(frequency[chosen], line))
        lines = frequency[chosen][own]
        narrow = lines[-1] < (NARROW_READING if reading else NARROW) * lines[0]
        level, growth = (line[own].mean(), 0.0) if narrow else _noise_level_and_growth(line[own], square[chosen][own])
        floors.append(np.sqrt((below * (level + growth * square)).sum() * spacing))
    return np.array(floors)


def is_sensor_reading(channel: Channel, flight: Flight) -> bool:
    """Return whether a channel is a direct sensor reading rather than a derivative."""
    return channel.kind == "rotor_speed" or (channel.kind == "specific_force" and flight.accelerometer)


def longest_airborne_rows(flight: Flight, time: Array, bandwidth: float) -> slice:
    """Return the rows at these times [s] of the longest airborne span without lost rows; all rows if nothing is excluded."""
    excluded = flight.rows_without_comparison(round(flight.rate / bandwidth))
    if excluded is None:
        return slice(None)
    spans = true_spans(~excluded[rows_at_times(flight, time)])
    return slice(*max(spans, key=lambda span: span[1] - span[0], default=(0, 0)))


def _num_unfiltered_lines(frequency: Array, density: Array) -> int:
    """Return the number of spectral lines below the sensor's low-pass, at least ``FEWEST_LINES``."""
    band = np.floor(np.log(frequency / frequency[0]) / np.log(BAND_RATIO)).astype(int)
    mean = np.bincount(band, weights=density) / np.maximum(np.bincount(band), 1)
    fallen = np.flatnonzero((mean < FALLEN * mean[0]) & (np.bincount(band) > 0))
    return max(int(np.sum(band < fallen[0])), FEWEST_LINES) if fallen.size else frequency.size


def _noise_level_and_growth(density: Array, square: Array) -> tuple[float, float]:
    """Return a, b >= 0 of ``a + b (2 pi f)²``, by least squares with errors proportional to the density."""
    weight = 1.0 / np.maximum(density, 1e-300)
    for _ in range(5):
        columns = np.stack((np.ones_like(square), square), axis=1) * weight[:, None]
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        (level, growth), _ = nnls(columns / size, density * weight)
        level, growth = level / size[0], growth / size[1]
        weight = 1.0 / np.maximum(level + growth * square, 1e-300)
    return float(level), float(growth)
