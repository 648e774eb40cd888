"""A robot's ``control:`` for a bandwidth and a damping, with the lag and the dead time that its file has identified.

Rotor lags are those of the robot with its effects (``motor_time_constant``, ``motor_asymmetry``), dead time is that of
``actuation_delay``. About yaw the loop is no quicker than the rotors' torque at hover gives for an error of 1 rad.
"""

from dataclasses import dataclass, replace

import torch

from aerial_gym.config.controller import ControlCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.control.allocation import Allocation
from aerial_gym.control.stability import ClosedLoop
from aerial_gym.control.tuner import tune_attitude, tune_position
from aerial_gym.physics.model import build_model, robot_effects
from aerial_gym.physics.vehicle import vehicle_from_config

GRAVITY = 9.81  # [m/s²]


@dataclass(frozen=True, kw_only=True)
class TuningResult:
    """The derived ``control:`` of a robot file and the resulting closed loop."""

    control: ControlCfg  # With frequencies and damping ratios of attitude and position
    lag: float  # Of the rotors [s]
    delay: float  # Dead time of the commands [s]
    yaw_limited: bool  # Whether yaw is slower than asked, as there is no more torque
    radius: float  # Spectral radius of the sampled loop of `lee_position_control` at hover; below 1 it comes to rest


def tune_robot(
    robot: RobotCfg, *, name: str, attitude: float, position: float, damping: float, dt: float
) -> TuningResult:
    """Return the control that meets a bandwidth and a damping ratio.

    Args:
        attitude: Bandwidth of roll, pitch and yaw [rad/s].
    """
    declared = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    effects = robot_effects(robot, num_envs=1, device=torch.device("cpu"), dtype=torch.float64, rigid=True)
    vehicle = build_model(declared, effects).vehicle
    delay = float(robot.effects.get("actuation_delay", {}).get("delay", 0.0))
    tuned = tune_attitude(vehicle, bandwidth=attitude, damping=damping, delay=delay, dt=dt)
    moved = tune_position(tuned, bandwidth=position, damping=damping)
    weight = robot.body.mass * GRAVITY
    authority = Allocation(declared, GRAVITY).torque_authority(weight) / declared.inertia[0].diagonal()
    frequency, ratio = tuned.natural_frequency[0], tuned.damping[0]
    most = float(authority[2].clamp_min(0.0).sqrt())
    limited = bool(frequency[2] > most)
    turn = (*frequency[:2].tolist(), min(float(frequency[2]), most))
    control = replace(
        robot.control,
        attitude_frequency=turn,
        attitude_damping=(*ratio[:2].tolist(), damping if limited else float(ratio[2])),
        position_frequency=tuple(moved.natural_frequency[0].tolist()),
        position_damping=tuple(moved.damping[0].tolist()),
        gains=None,
        source=(
            f"Tuned: aerial_gym.robots.tune for {attitude:g} rad/s of attitude, {position:g} rad/s of position, damping "
            f"{damping:g}, dt {dt:g} s"
        ),
    )  # fmt: skip
    loop = ClosedLoop(
        replace(robot, control=control), CONTROLLERS.get("lee_position_control"), gravity=GRAVITY, integrator="rk4",
        names=(name, "lee_position_control"),
    )  # fmt: skip
    lag = float(torch.maximum(vehicle.time_constant_up, vehicle.time_constant_down).max())
    return TuningResult(control=control, lag=lag, delay=delay, yaw_limited=limited, radius=loop.spectral_radius(dt))
