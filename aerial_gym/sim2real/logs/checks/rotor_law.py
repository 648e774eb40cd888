"""Check that the measured force rises with the rotor columns as the declared thrust map predicts.

A pulse width, a duty cycle or a thrust in place of a speed may give the right hover thrust with a wrong slope.
Relative to the declared slope these give 1.5 to 3, 1/2 and 2. Letters: T rows, R rotors, N windows.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import DataError
from aerial_gym.sim2real.arrays import Array, Flags
from aerial_gym.sim2real.logs.checks.units import SURE
from aerial_gym.sim2real.logs.recording import FlightLog, sample_rate
from aerial_gym.sim2real.logs.rotor_model import simulate_lag, total_rotor_force
from aerial_gym.sim2real.statistics import student_quantile

WINDOW_S = 0.25  # Length of the averaging windows [s]
FEWEST = 8  # Least surplus of windows over fitted coefficients
WRONG = float(np.sqrt(2.0))  # Ratio beyond which a slope is nearer to 2 or 1/2, those of a mistaken column, than to 1


def check_rotor_law(log: FlightLog, robot: RobotCfg, on_ground: Flags | None) -> None:
    """Raise ``DataError`` if the interval of the relative slope lies outside 1 / WRONG to WRONG."""
    for name, values in (("rotor", log.rotor_speed), ("cmd", log.rotor_command)):
        if values is None or log.specific_force is None:
            continue
        states = values if name == "rotor" else simulate_lag(robot, values, sample_rate(log))
        low, high = interval_of_thrust_slope(log, total_rotor_force(robot, states), on_ground)
        if high >= 1.0 / WRONG and low <= WRONG:
            continue
        unit = "N" if "force" in robot.rotor_traits else "rad/s"
        grows = f"{low:.2g} to {high:.2g} times as steeply with {name}_1..{values.shape[1]}"
        raise DataError(
            f"{log.path}: the measured force rises {grows} as the robot file declares; the columns probably hold not {unit} "
            "but a pulse width, a duty cycle or a thrust: convert them in a mapping file (power, gain, offset), or empty them"
        )


def interval_of_thrust_slope(log: FlightLog, thrust: Array, on_ground: Flags | None) -> tuple[float, float]:
    """Return the interval of ``d ln |f| / d ln T``, between both regressions (see ``units``); 0 to infinity: not observable."""
    assert log.specific_force is not None
    rows = max(1, round(WINDOW_S * sample_rate(log)))
    count = len(thrust) // rows

    def means(values: Array) -> Array:
        return values[: count * rows].reshape(count, rows, -1).mean(axis=1)

    regressors = [np.ones((count, 1))]
    if log.lin_vel is not None:
        speed = Rotation.from_quat(log.attitude).apply(log.lin_vel, inverse=True)
        regressors += [means(speed[:, 2:]), means(np.sum(speed[:, :2] ** 2, axis=1))]
    flies = np.full(count, True) if on_ground is None else means(on_ground.astype(float))[:, 0] == 0.0
    causes = np.concatenate(regressors, axis=1)[flies]
    pair = np.column_stack((np.linalg.norm(means(log.specific_force), axis=1), means(thrust)))[flies]
    free = len(pair) - causes.shape[1] - 1
    if free < FEWEST:
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
