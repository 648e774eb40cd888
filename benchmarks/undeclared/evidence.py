"""What a log can show: the expected evidence for a hidden effect, from the plant's equations and the noise of the logger alone.

``r`` is what the true vehicle makes the sensors read along a flight, less what the declared one does: specific force by
accelerometer and by velocity, angular acceleration by the gyro, gyro against attitude, rotor speeds against commands. It is
whitened by the spectra of the sensors' noise and of commands that the logger does not see. Small errors of vehicle and sensors
have their priors, the parameters of a rival effect any value. With all their directions D, ``q = r' (1 + D D')^-1 r`` remains.
The expected logarithm of the Bayes factor is ``q / 2 - k / 2 ln(1 + q / k)`` for k parameters; rivals are taken as linear.
Letters: F flights, T rows.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import log, pi

import numpy as np
from scipy.fft import dct
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from benchmarks.undeclared.dynamics import RATE, ROTOR, VEL, cross_matrix, rotation_matrices
from benchmarks.undeclared.effects import EFFECTS, cause_names, split_vehicles
from benchmarks.undeclared.full_dynamics import FullPlant
from benchmarks.undeclared.loggers import PlantLogger
from benchmarks.undeclared.plant_effect import Params
from benchmarks.undeclared.sensors import PlantNoise, PlantNuisance
from benchmarks.undeclared.simulate import CONTROL_RATE, PlantRecord
from benchmarks.undeclared.surroundings import NOMINAL_VOLTAGE, PlantSurroundings
from benchmarks.undeclared.vehicle import DECLARED, GRAVITY, Array, PlantVehicle

EVERY, BAND_HZ, OF_RATE = 8, 10.0, 0.2  # Samples in a row; highest frequency, and as a share of the rate of a channel
SLOWEST_HZ = 40.0  # Rotor data slower than this show neither torques nor lags
SHOWN = log(99.0 * len(EFFECTS))
"""Evidence with which an effect has 99 % among all effects, where each is as probable before the flights."""

NOT_RIVALS = (
    "gusts",
    "slung_payload",
    "joint_spring",
    "joint_creep",
)  # A state along the flight does not tell their forces
FORCE, VELOCITY, GYRO, TURN, SPEED = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12), slice(12, 16)
UNKNOWN_GAIN = 0.3  # Standard deviation of the relative gain of commands that are shares of the largest speed
SMOOTHING = 15  # Lines of a spectrum that are averaged
FREE = 1e4  # Standard deviation of the parameters of a rival, in units of its whole effect over the noise


class FlightStates:
    """Noise-free states of logged flights, and what a vehicle would make the sensors read in them."""

    def __init__(self, record: PlantRecord, flights: Sequence[int], first: int, logger: PlantLogger) -> None:
        """Take some flights of a record, from sample ``first`` on."""
        around, kept = record.surroundings, list(flights)
        series = {name: getattr(around, name) for name in ("gust", "other")}
        cut = {name: values[:, kept] for name, values in series.items() if values is not None}
        arrays = {name: getattr(record, name)[:, kept] for name in ("command", "state", "voltage")}
        record = replace(record, **arrays, surroundings=replace(around, **cut))
        self.record, self.logger, self._first = record, logger, first
        self._speeds: dict[tuple, tuple[Array, Array]] = {}  # With the commands, so that their identity stays theirs
        self.state = self.rows(record.state)
        every = round(CONTROL_RATE / logger.rate("command"))
        self.seen_commands = record.command[np.arange(len(record.command)) // every * every]
        self.has_torques = logger.rate("rotor" if logger.rotor_speeds else "command") >= SLOWEST_HZ

    def rows(self, values: Array) -> Array:
        """Return every ``EVERY``-th sample from the start of the log on."""
        return values[self._first :: EVERY]

    def _follow_commands(self, vehicle: PlantVehicle, command: Array) -> Array:
        """Return the rotor speeds [rad/s] that follow commands, at the rows, (T, F, 4)."""
        late, gain = round(vehicle.extra.delay * CONTROL_RATE), vehicle.extra.battery_gain
        key = (vehicle.tau_up, vehicle.tau_down, late, gain, id(command))
        if key not in self._speeds:
            supply = 1.0 + gain * (self.record.voltage[:, :, None] / NOMINAL_VOLTAGE - 1.0)
            target = np.concatenate((np.repeat(command[:1], late, axis=0), command))[: len(command)] * supply
            up, down = (-np.expm1(-1.0 / (CONTROL_RATE * tau)) for tau in (vehicle.tau_up, vehicle.tau_down))
            speeds, now = np.empty_like(target), target[0]
            for k, aim in enumerate(target):
                speeds[k] = now
                now = now + np.where(aim > now, up, down) * (aim - now)
            self._speeds[key] = command, self.rows(speeds)
        return self._speeds[key][1]

    def predict(self, vehicle: PlantVehicle, *, read: Array | None = None, command: Array | None = None) -> Array:
        """Return the readings along the flown states (T, F, 16), channels as in the slices above.

        Rotor speeds are those that were ``read`` (T, F, 4), else those that follow the ``command``. Without a command they are
        the true ones, and there are the true gusts.
        """
        extra, around = vehicle.extra, self.record.surroundings
        own = self.state[:, :, ROTOR] if command is None else self._follow_commands(vehicle, command)
        shape, state = self.state.shape[:2], self.state.reshape(-1, self.state.shape[2]).copy()
        state[:, ROTOR] = (own if read is None else read / extra.rotor_reading).reshape(-1, 4)
        series = {name: getattr(around, name) for name in (("gust", "other") if command is None else ("other",))}
        flat = {name: self.rows(values).reshape(1, -1, 3) for name, values in series.items() if values is not None}
        air = PlantSurroundings(gust=flat.get("gust"), other=flat.get("other"), ceiling=around.ceiling)
        plant = FullPlant(vehicle, air)
        plant.begin_sample(0, self.rows(self.record.voltage).ravel())
        late = round(extra.delay * CONTROL_RATE)
        sent = self.rows(self.record.command[np.maximum(np.arange(len(self.record.command)) - late, 0)])
        slope, turn = plant.derivative(state, sent.reshape(-1, 4)), cross_matrix(state[:, RATE])
        force = ((slope[:, VEL] + np.array([0.0, 0.0, GRAVITY]))[:, None] @ rotation_matrices(state))[:, 0]
        force = force - cross_matrix(slope[:, RATE]) @ vehicle.com - (turn @ turn) @ vehicle.com
        imu, bias = Rotation.from_euler("xyz", extra.imu_turn).as_matrix(), np.asarray(extra.imu_bias)
        tracked = Rotation.from_euler("xyz", extra.tracked_turn).as_matrix()
        gyro = state[:, RATE] @ imu + bias[3:] - state[:, RATE] @ tracked
        speeds = extra.rotor_reading * own.reshape(-1, 4)
        return np.hstack((force @ imu + bias[:3], force @ tracked, slope[:, RATE] @ imu, gyro, speeds)).reshape(
            *shape, 16
        )


def evidence_over_rivals(
    flown: FlightStates, params: Mapping[str, Params], noise: PlantNoise, nuisance: PlantNuisance
) -> dict[str, float]:
    """Return the expected logarithm of the Bayes factor of the hidden effects over each rival, ``nothing`` among them."""
    declared, true = split_vehicles(DECLARED, params)
    shown, command = flown.predict(true), flown.record.command
    read = shown[:, :, SPEED] if flown.logger.rotor_speeds else None

    def predict(vehicle: PlantVehicle, command: Array = command, read: Array | None = read) -> Array:
        return flown.predict(vehicle, read=read, command=command)

    base = predict(declared)
    white = _whitener(flown, noise, base, predict(declared, flown.seen_commands, _blur(flown, read, noise)))
    residual, count = white(shown - base), sum(map(len, params.values()))
    errors = _small_errors(flown, declared, base, predict, nuisance, read, shown[:, :, GYRO])
    known = np.stack([white(error) for error in errors], axis=1)
    results = {"nothing": _log_bayes_factor(residual, known, count)}
    own = {cause for name in params for cause in cause_names(name)}
    for label, vehicles in _rivals(flown, declared, own):
        free = np.stack([white(predict(vehicle) - base) for vehicle in vehicles], axis=1)
        size = np.linalg.norm(free, axis=0)
        free = FREE * free[:, size > 1e-6] / size[size > 1e-6]
        results[label] = _log_bayes_factor(residual, np.hstack((known, free)), count)
    return results


def _log_bayes_factor(residual: Array, directions: Array, count: int) -> float:
    """Return ``q / 2 - k / 2 ln(1 + q / k)``, with q what directions of unit prior leave of the residual."""
    along = directions.T @ residual
    inner = np.eye(len(along)) + directions.T @ directions
    left = max(float(residual @ residual - along @ np.linalg.solve(inner, along)), 0.0)
    return 0.5 * left - 0.5 * count * log(1.0 + left / count)


def _blur(flown: FlightStates, read: Array | None, noise: PlantNoise) -> Array | None:
    """Return rotor speeds with the noise of their sensors, averaged over a row."""
    if read is None:
        return None
    spread = noise.rotor * (CONTROL_RATE / EVERY / flown.logger.rate("rotor")) ** 0.5
    return read * (1.0 + spread * np.random.default_rng(0).standard_normal(read.shape))


def _whitener(flown: FlightStates, noise: PlantNoise, base: Array, seen: Array) -> Callable[[Array], Array]:
    """Return the map from readings (T, F, 16) to numbers of unit noise; frequencies that the log does not show are left out."""
    logger, rows = flown.logger, len(base)
    rate = CONTROL_RATE / EVERY
    frequency = np.arange(rows) * (0.5 * rate / rows)
    imu, attitude, position = (rate / logger.rate(name) for name in ("imu", "attitude", "position"))
    slope, gyro = (2.0 * pi * np.maximum(frequency, frequency[1])) ** 2, noise.gyro**2 * imu
    tilt = noise.attitude**2 * attitude
    speed = (noise.rotor * DECLARED.hover_speed()) ** 2 * rate / logger.rate("rotor")
    flat = np.ones(rows)
    spectra = (
        (FORCE, "imu", (noise.acc**2 + logger.vibration**2) * imu * flat),
        (VELOCITY, "position", slope * (noise.velocity**2 + logger.velocity_noise**2) * position + GRAVITY**2 * tilt),
        (GYRO, "imu", slope * gyro),
        (TURN, "attitude", gyro + slope * tilt),
        (SPEED, "imu", speed * flat),
    )
    weight = np.zeros((rows, 1, 16))
    unseen = uniform_filter1d((_spectrum(seen - base) ** 2).mean(axis=1), SMOOTHING, axis=0)
    for part, channel, spectrum in spectra:
        if part in (GYRO, SPEED) and not (flown.has_torques and (part == GYRO or logger.rotor_speeds)):
            continue
        used = (frequency <= min(BAND_HZ, OF_RATE * logger.rate(channel))) & (spectrum > 0.0)
        weight[used, 0, part] = (spectrum[used, None] + unseen[used, part]) ** -0.5
    kept = weight[:, 0] > 0.0
    return lambda values: (weight * _spectrum(values)).transpose(0, 2, 1)[kept].ravel()


def _spectrum(values: Array) -> Array:
    """Return the cosine transform along the first axis, which keeps white noise white."""
    return np.asarray(dct(values, norm="ortho", axis=0))


def _small_errors(
    flown: FlightStates,
    declared: PlantVehicle,
    base: Array,
    predict: Callable[..., Array],
    nuisance: PlantNuisance,
    read: Array | None,
    ang_acc: Array,
) -> Iterator[Array]:
    """Yield the change of the readings (T, F, 16) by each small error of one standard deviation.

    ``ang_acc``: true angular acceleration [rad/s²], (T, F, 3), which the gyro shows.
    """
    v, axes, logger = declared, np.eye(3), flown.logger
    vehicles = [replace(v, mass=v.mass * (1.0 + nuisance.mass))]
    vehicles += [replace(v, thrust_coeff=v.thrust_coeff * (1.0 + nuisance.thrust_coeff * one)) for one in np.eye(4)]
    stretch = [1.0 + 0.5 * nuisance.inertia * one for one in axes]
    vehicles += [replace(v, inertia=v.inertia * np.outer(one, one)) for one in stretch]
    vehicles += [replace(v, tau_up=v.tau_up * (1.0 + nuisance.tau), tau_down=v.tau_down * (1.0 + nuisance.tau))]
    vehicles += [replace(v, com=v.com + nuisance.com * one) for one in axes]
    yield from (predict(vehicle) - base for vehicle in vehicles)
    rate, step = flown.state[:, :, RATE], EVERY / CONTROL_RATE
    change = np.gradient(base, step, axis=0)

    def place_in_readings(part: slice, values: Array | float) -> Array:
        alone = np.zeros_like(base)
        alone[:, :, part] = values
        return alone

    for one in axes:
        lever = np.cross(ang_acc, one) + np.cross(rate, np.cross(rate, one))
        yield place_in_readings(FORCE, nuisance.acc_bias * one)
        yield place_in_readings(TURN, nuisance.gyro_bias * one)
        yield place_in_readings(FORCE, nuisance.acc_scale * one * base[:, :, FORCE])
        yield place_in_readings(FORCE, nuisance.imu_place * lever)
        yield place_in_readings(VELOCITY, nuisance.velocity_place * lever)
        turned = place_in_readings(VELOCITY, np.cross(one, base[:, :, VELOCITY])) + place_in_readings(
            TURN, np.cross(one, rate)
        )
        yield nuisance.attitude * turned
        for flight in range(base.shape[1]) if nuisance.acc_of_flight else ():
            alone = place_in_readings(FORCE, 0.0)
            alone[:, flight, FORCE] = nuisance.acc_of_flight * one
            yield alone
    turning = place_in_readings(TURN, np.gradient(rate, step, axis=0))
    delay, late = nuisance.delay, max(nuisance.delay, logger.late[1])
    yield place_in_readings(FORCE, delay * change[:, :, FORCE])
    yield place_in_readings(GYRO, delay * change[:, :, GYRO]) + delay * turning
    yield delay * turning + place_in_readings(VELOCITY, delay * np.cross(rate, base[:, :, VELOCITY]))
    yield place_in_readings(VELOCITY, late * change[:, :, VELOCITY])
    yield place_in_readings(VELOCITY, 0.5 * late**2 * np.gradient(change[:, :, VELOCITY], step, axis=0))
    if read is not None:
        yield predict(v, read=read + delay * np.gradient(read, step, axis=0)) - base
    if logger.file == "ulg":
        small = 0.01
        yield (predict(v, (1.0 + small) * flown.record.command) - base) * (UNKNOWN_GAIN / small)


def _rivals(flown: FlightStates, declared: PlantVehicle, own: set[str]) -> Iterator[tuple[str, list[PlantVehicle]]]:
    """Yield each rival, a rotor counting as one of its own, with vehicles whose readings span its effect."""
    around, rng = flown.record.surroundings, np.random.default_rng(0)
    for name, effect in EFFECTS.items():
        absent = {"ceiling": around.ceiling is None, "other": around.other is None}
        if name in own or name in NOT_RIVALS or any(absent.get(need, False) for need in effect.needs):
            continue
        draws = [effect.draw(rng, rng.uniform(*effect.ranges[1]), declared) for _ in range(len(effect.params) + 1)]
        drawn = [key for key in effect.params if key != "motor" and draws[0][key] != draws[1][key]]
        for motor in range(1, 5) if "motor" in effect.params else (0,):
            chosen = [draw | ({"motor": float(motor)} if motor else {}) for draw in draws[: max(len(drawn), 1)]]
            yield f"{name} {motor}" if motor else name, [effect.apply(declared, one) for one in chosen]
