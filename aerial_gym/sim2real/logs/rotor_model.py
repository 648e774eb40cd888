"""Forces of the declared rotors at logged states: speeds [rad/s], or thrusts [N] in force mode; and their lag.

Letters: T rows of a log, R rotors.
"""

from dataclasses import dataclass

import numpy as np
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.effects.rotor_failures import nominal_lag
from aerial_gym.physics.rotors import rotor_thrust, rotor_torque
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.signals import apply_lag, interpolate_columns

SETTLE_S = 0.5  # Time until rotors that follow commands forget their initial state [s]
LAG_STEPS = 4  # Linear fits of the rotor lag behind commands that are shares


def rotor_thrusts(robot: RobotCfg, speed: Array) -> Array:
    """Return the thrusts [N], (T, R), at states (T, R)."""
    rows = vehicle_from_config(robot, num_envs=len(speed), dtype=torch.float64)
    return rotor_thrust(rows, torch.from_numpy(np.ascontiguousarray(speed, dtype=float))).numpy()


def rotor_drag_torques(robot: RobotCfg, speed: Array) -> Array:
    """Return the drag torques [N m], (T, R), at states (T, R)."""
    rows = vehicle_from_config(robot, num_envs=len(speed), dtype=torch.float64)
    return rotor_torque(rows, torch.from_numpy(np.ascontiguousarray(speed, dtype=float))).numpy()


def total_rotor_force(robot: RobotCfg, speed: Array) -> Array:
    """Return the norm of the total rotor force [N], (T,), at states (T, R), for any rotor axes."""
    axes = np.array([mount.axis for mount in robot.mounts.layout])
    return np.linalg.norm(rotor_thrusts(robot, speed) @ (axes / np.linalg.norm(axes, axis=1, keepdims=True)), axis=1)


def place_of_rotor(robot: RobotCfg, number: int) -> str:
    """Return a pilot's name for the place of a rotor (from 1), such as ``front left``; empty if not unique."""
    hubs = np.array([mount.position for mount in robot.mounts.layout])[:, :2]
    arms = hubs - hubs.mean(axis=0)
    places = [_sector_name(arm, float(np.linalg.norm(arms, axis=1).max())) for arm in arms]
    if not 0 < number <= len(places) or places.count(places[number - 1]) > 1:
        return ""
    return places[number - 1]


SIDES = ("front", "front left", "left", "rear left", "rear", "rear right", "right", "front right")
"""Eight sectors about body z, counter-clockwise from the front."""


def _sector_name(arm: Array, longest: float) -> str:
    if np.linalg.norm(arm) < 0.1 * longest:
        return "centre"
    return SIDES[round(float(np.arctan2(arm[1], arm[0])) / (0.25 * np.pi)) % len(SIDES)]


def mean_time_constant(robot: RobotCfg) -> float:
    """Return the mean of the declared time constants up and down [s]."""
    return 0.5 * sum(nominal_lag(robot))


def simulate_lag(robot: RobotCfg, command: Array, rate: float) -> Array:
    """Return the commands (T, R) after the declared first-order lag, at a rate [Hz]."""
    kept = float(np.exp(-1.0 / (rate * mean_time_constant(robot))))
    return apply_lag(command, kept, command[0])


@dataclass(frozen=True, kw_only=True)
class LineBehindLag:
    """Steady speed ``idle + slope u`` [rad/s] of a command u, and the lag and dead time of the speed behind it."""

    idle: float  # [rad/s]
    slope: float
    time_constant: float  # [s]
    delay: float  # Dead time beside the lag [s]


def fit_line_behind_lag(
    share: Array, speed: Array, robot: RobotCfg, rate: float, *, above: Array | None = None
) -> LineBehindLag:
    """Return the line, the lag and the dead time of speeds that follow commands u, (T, R) each.

    A delay that is left out weakens the slope, slower falls than rises lift the mean. Gauss-Newton steps begin at the declared
    lag H(s): the derivative by the time constant is ``-H (1 - H) u / tau``, its parts above and below the speed are those of
    rises and falls; the derivative by the delay is ``-d/dt``. ``above``: relative voltage above the nominal one, (T,), which
    may change the slope; the line is that at nominal voltage.
    """
    tau, delay, idle, slope = max(mean_time_constant(robot), 1.0 / rate), 0.0, 0.0, 0.0
    settled, time = slice(min(round(SETTLE_S * rate), len(share) // 2), None), np.arange(len(share)) / rate
    for _ in range(LAG_STEPS):
        kept, still = float(np.exp(-1.0 / (rate * tau))), np.zeros(share.shape[1])
        lagged = apply_lag(share, kept, share[0])
        away = share - lagged
        parts = [apply_lag(part, kept, still) for part in (np.maximum(away, 0.0), np.minimum(away, 0.0))]
        late, rises, falls = (interpolate_columns(time - delay, time, one) for one in (lagged, *parts))
        columns = [np.ones_like(share), late, rises, falls, -np.gradient(late, 1.0 / rate, axis=0)]
        columns += [] if above is None else [late * above[:, None]]
        regressors = np.column_stack([one[settled].ravel() for one in columns])
        values = np.linalg.lstsq(regressors, speed[settled].ravel(), rcond=None)[0]
        idle, slope, up, down, more = (float(x) for x in values[:5])
        tau *= float(np.clip(1.0 - 0.5 * (up + down) / slope, 0.5, 2.0)) if slope > 0.0 else 1.0
        delay += float(np.clip(more / slope, -tau, tau)) if slope > 0.0 else 0.0
    return LineBehindLag(idle=idle, slope=slope, time_constant=tau, delay=delay)
