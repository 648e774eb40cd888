"""Detection of rows in which the vehicle does not fly by its own power. Letters: T rows, R rotors."""

import numpy as np
from scipy import ndimage

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.flight_spans import SHOCK_S, shocks
from aerial_gym.sim2real.logs.recording import AT_REST, HIGHEST_BAND, FlightLog, comparable_rate, sample_rate
from aerial_gym.sim2real.logs.rotor_model import simulate_lag, total_rotor_force
from aerial_gym.sim2real.logs.signals import num_edge_rows

SMOOTH_S = 0.05  # Width of the Gaussian smoothing [s], which does not ring at a touchdown and removes noise
IDLE = 0.5  # Below this share of the flight's thrust the rotors do not carry the vehicle
LIFTING = 0.9  # A vehicle on the ground remains there until the thrust reaches this share
CARRIED = 0.8  # Least specific force [g] of a supported vehicle; in free fall it is less
STILL = {"lin_vel": 0.15, "ang_vel": 0.15}  # Largest speeds [m/s], [rad/s] at rest
MOST = 0.8  # Largest share of rows on the ground in a usable log


def rows_on_ground(log: FlightLog, robot: RobotCfg) -> Flags | None:
    """Return the rows on the ground, in a hand or thrown, (T,); None if there are none or the data do not show it.

    On the ground the vehicle is at rest, supported, and below half its flight thrust. Neighbours at rest below nine tenths
    of the thrust belong to it, and all rows within the mapping's ``lift_off_m`` of that height. A height alone is no
    evidence. It is carried where a force beyond rotors and rotation supports it, below half its thrust; neighbours below
    half, as after a throw, belong to it. Impacts where it flies close above a place where it stands belong to the ground.
    """
    rotors, width = log.rotor_speed, SMOOTH_S * sample_rate(log)
    if rotors is None and log.rotor_command is not None:
        rotors = simulate_lag(robot, log.rotor_command, sample_rate(log))
    felt = _specific_force_norm(log, width)
    if felt is None or rotors is None:
        return None
    thrust = ndimage.gaussian_filter1d(total_rotor_force(robot, rotors), width)
    thrust = thrust / min(float(np.percentile(thrust, 90.0)), robot.body.mass * STANDARD_GRAVITY)
    supported = felt > CARRIED * STANDARD_GRAVITY
    rest = supported.copy()
    for name, limit in STILL.items():
        values = getattr(log, name)
        if values is not None:
            rest &= _norm_of_smoothed_vectors(values, width) < limit
    on_ground = _spans_containing(rest & (thrust < LIFTING), rest & (thrust < IDLE))
    impacts = _rows_of_impacts(log, robot, rotors, on_ground)
    if log.specific_force is not None and log.ang_vel is not None:
        beyond = felt - thrust * STANDARD_GRAVITY - _largest_centripetal_acceleration(log.ang_vel, robot, width)
        on_ground |= _spans_containing(thrust < IDLE, (thrust < IDLE) & (beyond > CARRIED * STANDARD_GRAVITY))
    if not on_ground.any():
        return None
    on_ground |= impacts
    if log.lift_off > 0.0 and log.position is not None:
        on_ground |= _rows_near_heights(log.position[:, 2], on_ground, log.lift_off)
    if on_ground.mean() > MOST:
        raise DataError(
            f"{log.path}: the vehicle stands on the ground in {on_ground.mean():.0%} of the rows: at rest, while its rotors "
            "give less than half its weight; cut the log to the flight"
        )
    return on_ground


def _spans_containing(rows: Flags, certain: Flags) -> Flags:
    """Return the spans of consecutive ``rows`` that contain a ``certain`` row, (T,)."""
    piece = np.cumsum(np.diff(rows, prepend=False))
    return rows & np.isin(piece, piece[certain])


def _rows_near_heights(height: Array, on_ground: Flags, reach: float) -> Flags:
    """Return the rows within ``reach`` [m] of the lowest height of any span on the ground, (T,)."""
    pieces, count = ndimage.label(on_ground)  # pyright: ignore[reportGeneralTypeIssues]
    levels = np.atleast_1d(ndimage.minimum(height, pieces, np.arange(1, count + 1)))
    return np.any([np.abs(height - level) <= reach for level in levels], axis=0)


def _rows_of_impacts(log: FlightLog, robot: RobotCfg, rotors: Array, stands: Flags) -> Flags:
    """Return the rows with impacts of a vehicle that flies no higher over a place where it ``stands`` than it is long, (T,).

    Rotors lag, so that the force changes faster than their thrust only by contact.
    """
    force, rows, impacts = log.specific_force, max(1, round(SHOCK_S * sample_rate(log))), np.zeros_like(stands)
    if force is None or log.position is None or not stands.any():
        return impacts
    near = _rows_near_heights(log.position[:, 2], stands, _largest_radius(robot))
    thrust = total_rotor_force(robot, rotors) / robot.body.mass
    changes = np.linalg.norm(force[rows:] - force[:-rows], axis=1) - np.abs(thrust[rows:] - thrust[:-rows])
    flies = ~(stands[rows:] | stands[:-rows])
    shocked = np.flatnonzero(flies)[shocks(changes[flies], near[rows:][flies])]
    for shift in range(rows + 1):
        impacts[shocked + shift] = True
    return impacts


def _largest_radius(robot: RobotCfg) -> float:
    """Return the distance of the outermost rotor from the centre of mass [m]."""
    places = np.array([mount.position for mount in robot.mounts.layout]) - robot.body.com
    return float(np.linalg.norm(places, axis=1).max())


def _largest_centripetal_acceleration(ang_vel: Array, robot: RobotCfg, width: float) -> Array:
    """Return ``w² r`` [m/s²], (T,), of an accelerometer as far from the centre of mass as the outermost rotor."""
    return _norm_of_smoothed_vectors(ang_vel, width) ** 2 * _largest_radius(robot)


def check_airborne(log: FlightLog, on_ground: Flags | None, bandwidth: float) -> None:
    """Raise ``DataError`` unless one airborne span exceeds the end rows that a low-pass at ``bandwidth`` [Hz] spoils."""
    rate = sample_rate(log)
    edge = num_edge_rows(rate, min(bandwidth, HIGHEST_BAND * comparable_rate(log, rate)))
    flies = np.ones(log.time.size, dtype=bool) if on_ground is None else ~on_ground
    if not np.asarray(ndimage.minimum_filter1d(flies, 2 * edge + 1, mode="constant", cval=0)).any():
        raise DataError(
            f"{log.path}: the vehicle is never airborne for {(2 * edge + 1) / sample_rate(log):.2g} s at a time; a "
            f"comparison below {bandwidth:g} Hz needs more. Give a log of a flight, or compare "
            "below a higher frequency (bandwidth_hz)"
        )


def _specific_force_norm(log: FlightLog, width: float) -> Array | None:
    """Return the smoothed specific force [m/s²], (T,), from the accelerometer or else the velocity; None without both."""
    if log.specific_force is not None:
        return _norm_of_smoothed_vectors(log.specific_force, width)
    if log.lin_vel is None:
        return None
    change = sample_rate(log) * ndimage.gaussian_filter1d(log.lin_vel, width, axis=0, order=1)
    return np.linalg.norm(change + AT_REST, axis=1)


def _norm_of_smoothed_vectors(values: Array, width: float) -> Array:
    """Return the norm of the smoothed vectors, (T,)."""
    return np.linalg.norm(ndimage.gaussian_filter1d(values, width, axis=0), axis=1)
