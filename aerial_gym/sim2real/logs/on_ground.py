"""When a vehicle is carried by something else than its rotors: it stands before take-off and after landing.

Letters: T rows, R rotors.
"""

import numpy as np
from scipy import ndimage

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.declared_rotors import followed, lift
from aerial_gym.sim2real.logs.recording import AT_REST, HIGHEST_BAND, FlightLog, rate_of
from aerial_gym.sim2real.logs.signals import edge_rows

SMOOTH_S = 0.05
"""Signals are smoothed by a bell of this width [s], which does not ring at a touch: noise is no motion."""

IDLE = 0.5
"""Rotors that give less than this share of what they give in flight do not carry the vehicle."""

LIFTING = 0.9
"""A vehicle that stands goes on to stand until its rotors give this share."""

CARRIED = 0.8
"""A specific force of this many g and more: the vehicle does not fall."""

STILL = {"lin_vel": 0.15, "ang_vel": 0.15}
"""Slower than this [m/s], [rad/s] the vehicle is at rest."""

MOST = 0.8
"""A vehicle that stands in more of the rows than this did not fly."""


def rows_on_ground(log: FlightLog, robot: RobotCfg) -> Flags | None:
    """Return in which rows the vehicle stands, (T,); None if in none, or if nothing tells.

    It stands where it is at rest and feels gravity while its rotors give less than half the thrust of the flight, and in the
    rows beside, as long as it is at rest and the rotors give less than nine tenths. Where it stood once it stands in all rows
    within the mapping's ``lift_off_m`` of that height. A height alone is no evidence: it may be that of a hover.

    Raises:
        DataError: If it stands nearly all the time.
    """
    rotors, width = log.rotor_speed, SMOOTH_S * rate_of(log)
    if rotors is None and log.rotor_command is not None:
        rotors = followed(robot, log.rotor_command, rate_of(log))
    felt = _felt(log, width)
    if felt is None or rotors is None:
        return None
    thrust = ndimage.gaussian_filter1d(lift(robot, rotors), width)
    thrust = thrust / min(float(np.percentile(thrust, 90.0)), robot.body.mass * STANDARD_GRAVITY)
    rest = felt > CARRIED * STANDARD_GRAVITY
    for name, limit in STILL.items():
        values = getattr(log, name)
        if values is not None:
            rest &= _size(values, width) < limit
    certain = rest & (thrust < IDLE)
    if not certain.any():
        return None
    likely = rest & (thrust < LIFTING)
    piece = np.cumsum(np.diff(likely, prepend=False))
    on_ground = likely & np.isin(piece, piece[certain])
    if log.lift_off > 0.0 and log.position is not None:
        on_ground |= _at_height_of(on_ground, log.position[:, 2], log.lift_off)
    if on_ground.mean() > MOST:
        raise DataError(
            f"{log.path}: the vehicle stands on the ground in {on_ground.mean():.0%} of the rows: at rest, while its rotors "
            "give less than half its weight; cut the log to the flight"
        )
    return on_ground


def check_airborne(log: FlightLog, on_ground: Flags | None, bandwidth: float) -> None:
    """Raise ``DataError`` if no span without touch of the ground is longer than the low-pass spoils at its ends.

    ``bandwidth``: of the comparison [Hz].
    """
    edge = edge_rows(rate_of(log), min(bandwidth, HIGHEST_BAND * rate_of(log)))
    flies = np.ones(log.time.size, dtype=bool) if on_ground is None else ~on_ground
    if not np.asarray(ndimage.minimum_filter1d(flies, 2 * edge + 1, mode="constant", cval=0)).any():
        raise DataError(
            f"{log.path}: the vehicle is never airborne for {(2 * edge + 1) / rate_of(log):.2g} s at a time, as a comparison "
            f"below {bandwidth:g} Hz needs; give a log of a flight, or compare below a higher frequency (bandwidth_hz)"
        )


def _felt(log: FlightLog, width: float) -> Array | None:
    """Return the size of the specific force [m/s²], (T,), of the accelerometer or else of the velocity; None without both."""
    if log.specific_force is not None:
        return _size(log.specific_force, width)
    if log.lin_vel is None:
        return None
    change = rate_of(log) * ndimage.gaussian_filter1d(log.lin_vel, width, axis=0, order=1)
    return np.linalg.norm(change + AT_REST, axis=1)


def _at_height_of(stands: Flags, height: Array, reach: float) -> Flags:
    """Return the rows (T,) within ``reach`` [m] of the lowest height of any piece of rows in which the vehicle stands."""
    pieces, count = ndimage.label(stands)  # pyright: ignore[reportGeneralTypeIssues]
    levels = ndimage.minimum(height, pieces, np.arange(1, count + 1))
    return np.any([np.abs(height - level) <= reach for level in np.atleast_1d(levels)], axis=0)


def _size(values: Array, width: float) -> Array:
    """Return the length of smoothed vectors, (T,)."""
    return np.linalg.norm(ndimage.gaussian_filter1d(values, width, axis=0), axis=1)
