"""Check number, unit, sign, order and thrust slope of rotor and command columns.

They hold rotor speeds [rad/s], or thrusts [N] in force mode. A pulse width, a duty cycle or a thrust in place of a speed may
give the right hover thrust, with 1.5 to 3, 1/2 and 2 times the declared slope. Letters: T rows, R rotors, N orders.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque, rotor_wrench
from aerial_gym.sim2real.arrays import Array, Flags, Indices
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.logs.checks.kinematics import BLOCK_S, CHECK_BANDWIDTH_HZ, WORST_AGREEMENT, gain_of_blocks
from aerial_gym.sim2real.logs.checks.units import SURE
from aerial_gym.sim2real.logs.readers.mapping import UNITS
from aerial_gym.sim2real.logs.recording import FlightLog, Recording, sample_rate
from aerial_gym.sim2real.logs.rotor_model import simulate_lag, total_rotor_force
from aerial_gym.sim2real.logs.signals import lowpass, num_edge_rows
from aerial_gym.sim2real.statistics import student_quantile


def check_rotor_columns(log: FlightLog, robot: RobotCfg) -> None:
    """Raise ``DataError`` for rotor columns with a wrong number, unit or sign."""
    if log.num_rotors != robot.num_rotors:
        raise DataError(
            f"{log.path}: has {log.num_rotors} rotor columns, the robot has {robot.num_rotors} rotors; "
            "give the robot that flew, or correct the columns"
        )
    if log.rotor_speed is not None and "force" in robot.rotor_traits:
        raise DataError(
            f"{log.path}: has measured rotor speeds (rotor_1..{log.num_rotors}), but the robot has rotors in force mode, whose "
            "state is a thrust, and no map from one to the other; leave these columns empty, so that thrusts follow from the "
            "commands (cmd_* in N), or declare the rotors in speed mode, with a thrust_map"
        )
    for name, values in (("rotor", log.rotor_speed), ("cmd", log.rotor_command)):
        if values is not None:
            _check_sign_of_rotor_column(log, name, values, robot)
            _check_unit_of_rotor_column(log, name, values, robot)


def without_copied_commands(log: FlightLog) -> FlightLog:
    """Return the log without commands that equal the measured speeds in every digit, as real rotors lag."""
    speed, command = log.rotor_speed, log.rotor_command
    if speed is None or command is None or not np.array_equal(speed, command):
        return log
    return replace(log, rotor_command=None, notes=(*log.notes, Finding("commands_copied")))


def with_shared_rotor_quantities(logs: Sequence[FlightLog]) -> list[FlightLog]:
    """Return the logs without measured rotor speeds if some have none and all have commands, which then drive the rotors."""
    lacking = [log.name for log in logs if log.rotor_speed is None]
    if len(lacking) in (0, len(logs)) or any(log.rotor_command is None for log in logs):
        return list(logs)
    note = Finding("rotor_speeds_not_shared", "", {"without": lacking})
    return [log if log.rotor_speed is None else _without_rotor_speeds(log, note) for log in logs]


def _without_rotor_speeds(log: FlightLog, note: Finding) -> FlightLog:
    streams = {name: stream for name, stream in log.streams.items() if name != "rotor_speed"}
    return replace(log, rotor_speed=None, streams=streams, notes=(*log.notes, note))


def _check_sign_of_rotor_column(log: FlightLog, name: str, values: Array, robot: RobotCfg) -> None:
    """Refuse a negative median speed of a rotor that is not reversible; noise at rest may be negative."""
    one_way = np.array([not rotor.reversible for rotor in robot.rotor_types])
    backwards = np.flatnonzero((np.median(values, axis=0) < 0.0) & one_way)
    if backwards.size:
        raise DataError(
            f"{log.path}: {name}_{backwards[0] + 1} is negative (median {np.median(values[:, backwards[0]]):.4g}); log them "
            "without sign: in which direction a rotor turns is declared in the robot file (spin); a reversible rotor has a "
            "thrust_range that begins below 0"
        )


def _check_unit_of_rotor_column(log: FlightLog, name: str, values: Array, robot: RobotCfg) -> None:
    """Check that the declared thrust at high logged speeds is the weight within a factor of three."""

    def thrust_at_90th_percentile(states: Array) -> float:
        return float(np.percentile(total_rotor_force(robot, states), 90.0))

    thrust, unit = thrust_at_90th_percentile(values), "N" if "force" in robot.rotor_traits else "rad/s"
    if thrust == 0.0:
        raise DataError(
            f"{log.path}: {name}_1..{values.shape[1]} (largest {values.max():.4g}) give the declared robot no thrust in nine "
            "of ten rows; leave the columns empty if the rotors were not measured"
        )
    ratio = thrust / (robot.body.mass * STANDARD_GRAVITY)
    if 1.0 / 3.0 < ratio < 3.0:
        return
    guess = f"check the unit ({unit}) and the robot"
    for other in ("rpm", "rev/s"):
        if unit == "rad/s" and 0.5 < thrust_at_90th_percentile(UNITS[other] * values) * ratio / thrust < 2.0:
            guess = f"it looks like {other}: convert to rad/s, or give unit: {other} in a mapping file"
    if np.all((values >= 0.0) & (values <= 1.0)):
        guess = f"it looks like a fraction of full throttle: leave these columns out, or convert them to {unit}"
    raise DataError(
        f"{log.path}: {name}_1..{values.shape[1]} (90th percentile {np.percentile(values, 90.0):.4g}) would give {ratio:.3g} "
        f"times the weight of the declared robot; {guess}"
    )


MOST_ROTORS = 6  # More rotors have too many orders to try
BETTER = 0.4  # Another order is accepted if its residual about the worst axis is less than this share of the declared order's
MORE_PROBABLE = 1e4  # Least likelihood ratio of another order of the rotors that refuses the declared one


def check_rotor_order(log: FlightLog, robot: RobotCfg, on_ground: Flags | None = None) -> list[Finding]:
    """Raise ``DataError`` if the courses of the angular acceleration make another order of the rotor columns probable.

    Each axis has a free gain, so wrong moments of inertia or thrusts do not matter; only airborne rows count. Return a finding
    if the reaction to the declared spins certainly has the wrong sign.
    """
    if log.ang_vel is None or log.collective or not log.torques or not 2 <= robot.num_rotors <= MOST_ROTORS:
        return []
    notes = list[Finding]()
    rate = sample_rate(log)
    edge, stride = num_edge_rows(rate, CHECK_BANDWIDTH_HZ), max(1, round(rate / (5.0 * CHECK_BANDWIDTH_HZ)))
    flies = np.ones(log.time.size, dtype=bool)
    if on_ground is not None:
        flies = ~np.asarray(ndimage.maximum_filter1d(on_ground, 2 * edge + 1), dtype=bool)
    flies = flies[edge:-edge:stride]
    if not flies.any():
        return []

    def lowpass_without_mean(values: Array, *, derivative: bool = False) -> Array:
        filtered = lowpass(values, rate, CHECK_BANDWIDTH_HZ, derivative=derivative)[edge:-edge:stride][flies]
        return filtered - filtered.mean(axis=0)

    inertia = np.array(robot.body.inertia)
    turning = lowpass_without_mean(log.ang_vel, derivative=True)
    turning = turning + lowpass_without_mean(np.cross(log.ang_vel, log.ang_vel @ inertia)) @ np.linalg.inv(inertia)
    for name, values in (("rotor", log.rotor_speed), ("cmd", log.rotor_command)):
        if values is None:
            continue
        orders = np.array(list(permutations(range(robot.num_rotors))))  # the declared order is first
        levers, reactions = _angular_acceleration_by_rotors(robot, lowpass_without_mean, values, orders, inertia)
        left = np.stack([_residual_shares(turning, levers + sign * reactions) for sign in (1.0, -1.0)])
        independent = flies.sum() * stride / rate * CHECK_BANDWIDTH_HZ
        log_likelihood = -0.5 * independent * np.log(np.maximum(left, 1e-12)).sum(axis=-1)
        flip, best = (int(k) for k in np.unravel_index(int(np.argmax(log_likelihood)), log_likelihood.shape))
        declared = float(np.sqrt(left[0, 0].mean()))
        gained = log_likelihood[flip, best] - log_likelihood[0, 0]
        worst = int(np.argmax(left[0, 0]))  # Axis about which the declared order is worst
        was, became = np.sqrt((left[0, 0, worst], left[flip, best, worst]))
        if best and was > WORST_AGREEMENT and became < BETTER * was and gained > np.log(MORE_PROBABLE):
            columns = ", ".join(f"{name}_{column + 1}" for column in orders[best])
            raise DataError(
                f"{log.path}: {name}_1..{robot.num_rotors} in the declared order predict the angular acceleration with an "
                f"error of {declared:.0%}; the probable order is {columns}{', with all spins reversed' * flip}: reorder the "
                f"columns or the robot's mounts{', or correct the sign of one axis of attitude and gyro' * flip}"
            )
        gain, half_width = _gain_of_reaction(turning - levers[0], reactions[0], max(1, round(BLOCK_S * rate / stride)))
        if gain + half_width < 0.0 and not notes:
            sizes = {"gain_ratio": gain, "half_width_ratio": half_width}
            notes.append(Finding("spins_reversed", "", {"columns": f"{name}_1..{robot.num_rotors}", **sizes}))
    return notes


def _gain_of_reaction(turning: Array, reaction: Array, rows: int) -> tuple[float, float]:
    """Return the regression of ``turning`` on the rotors' ``reaction``, (T, 3) each, with half width at ``SURE``.

    It is 1 for the declared spins and -1 for reversed ones. Blocks of ``rows`` are independent.
    """
    starts = np.arange(0, len(turning), rows)
    along, square = (np.add.reduceat((one * reaction).sum(axis=1), starts) for one in (turning, reaction))
    if starts.size <= FEWEST_WINDOWS or not square.sum() > 0.0:
        return 1.0, np.inf
    gain, std = gain_of_blocks(along, square)
    return gain, float(-student_quantile(SURE, starts.size - 1) * std)


def _angular_acceleration_by_rotors(
    robot: RobotCfg,
    lowpass_without_mean: Callable[[Array], Array],
    values: Array,
    orders: Indices,
    inertia: Array,
) -> tuple[Array, Array]:
    """Return the angular acceleration by thrusts and by reactions of the rotors under each order, (N, T, 3) each."""
    one, count = vehicle_from_config(robot, num_envs=1, dtype=torch.float64), robot.num_rotors
    single, none = torch.eye(count, dtype=torch.float64), torch.zeros(count, count, dtype=torch.float64)
    lever, reaction = (rotor_wrench(one, *pair)[1].numpy() for pair in ((single, none), (none, single)))
    speed = torch.from_numpy(values)
    thrust, drag = (lowpass_without_mean(values(one, speed).numpy()) for values in (rotor_thrust, rotor_torque))
    pairs, inverse = ((thrust, lever), (drag, reaction)), np.linalg.inv(inertia)
    levers, reactions = (np.einsum("tnr,rk->ntk", of_each[:, orders], arm) @ inverse for of_each, arm in pairs)
    return levers, reactions


def _residual_shares(turning: Array, expected: Array) -> Array:
    """Return the share of each axis' mean square that N courses (N, T, 3) leave, each with its best gain >= 0, (N, 3)."""
    along = np.maximum(np.einsum("tk,ntk->nk", turning, expected), 0.0)
    squares = np.sum(turning**2, axis=0) * np.sum(expected**2, axis=1)
    return 1.0 - along**2 / np.maximum(squares, 1e-300)


WINDOW_S = 0.25  # Length of the averaging windows [s]
FEWEST_WINDOWS = 8  # Least surplus of windows over fitted coefficients
WRONG_SLOPE = 2.0**0.5  # Ratio beyond which a slope is nearer to 2 or 1/2, those of a mistaken column, than to 1


def check_rotor_law(log: FlightLog, robot: RobotCfg, on_ground: Flags | None) -> None:
    """Raise ``DataError`` if the interval of the relative slope lies outside 1 / WRONG_SLOPE to WRONG_SLOPE."""
    for name, values in (("rotor", log.rotor_speed), ("cmd", log.rotor_command)):
        if values is None or log.specific_force is None:
            continue
        states = values if name == "rotor" else simulate_lag(robot, values, sample_rate(log))
        low, high = interval_of_thrust_slope(log, total_rotor_force(robot, states), on_ground)
        if high >= 1.0 / WRONG_SLOPE and low <= WRONG_SLOPE:
            continue
        unit = "N" if "force" in robot.rotor_traits else "rad/s"
        grows = f"{low:.2g} to {high:.2g} times as steeply with {name}_1..{values.shape[1]}"
        raise DataError(
            f"{log.path}: the measured force rises {grows} as the robot file declares; the columns probably hold not {unit} "
            "but a pulse width, a duty cycle or a thrust: convert them in a mapping file (power, gain, offset), or empty them"
        )


def interval_of_thrust_slope(
    log: Recording, thrust: Array, on_ground: Flags | None, *, beside: Array | None = None
) -> tuple[float, float]:
    """Return the interval of ``d ln |f| / d ln T``, between both regressions (see ``units``); 0 to infinity: not observable.

    Inflow, lift and height are causes of the force beside the thrust: a controller lowers the thrust where a ceiling or the
    ground adds to it. ``beside``: another cause, (T,), such as the voltage.
    """
    assert log.specific_force is not None
    rows = max(1, round(WINDOW_S * sample_rate(log)))
    count = len(thrust) // rows

    def window_means(values: Array) -> Array:
        return values[: count * rows].reshape(count, rows, -1).mean(axis=1)

    regressors = [np.ones((count, 1))]
    if log.lin_vel is not None:
        speed = Rotation.from_quat(log.attitude).apply(log.lin_vel, inverse=True)
        regressors += [window_means(speed[:, 2:]), window_means(np.sum(speed[:, :2] ** 2, axis=1))]
    if log.position is not None:
        height = window_means(log.position[:, 2:])
        height -= height.mean()
        regressors += [height, height**2]
    regressors += [] if beside is None else [window_means(beside)]
    flies = np.full(count, True) if on_ground is None else window_means(on_ground.astype(float))[:, 0] == 0.0
    causes = np.concatenate(regressors, axis=1)[flies]
    pair = np.column_stack((np.linalg.norm(window_means(log.specific_force), axis=1), window_means(thrust)))[flies]
    free = len(pair) - causes.shape[1] - 1
    if free < FEWEST_WINDOWS:
        return 0.0, np.inf
    left = pair - causes @ np.linalg.lstsq(causes, pair, rcond=None)[0]
    spread = np.sqrt(np.mean(left**2, axis=0))
    if not np.all(spread > 0.0):
        return 0.0, np.inf
    share = float(np.mean(left[:, 0] * left[:, 1]) / np.prod(spread))
    error = -float(student_quantile(SURE, free)) * np.sqrt(max(1.0 - share**2, 0.0) / free) / max(abs(share), 1e-12)
    if error >= 1.0 or share < 0.0:
        return 0.0, np.inf
    size = float(spread[0] / spread[1] * pair[:, 1].mean() / pair[:, 0].mean())
    return share * size / np.exp(error), size / share * np.exp(error)
