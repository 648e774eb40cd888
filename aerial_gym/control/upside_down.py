"""Upside-down starts without recovery: tilted by more than 90 degrees, with no righting torque of the control law.

Laws that compare rotation matrices (``lee_*``, ``pid_*``) command a torque with the sine of the angle, which vanishes only at
exactly 180 degrees. The Crazyflie's Mellinger controller gives no torque while its thrust along the body is negative, from 90
degrees on. ``allocation: clamp`` has much the same effect on laws with such a thrust, because all rotors are then at their
lower limit. Laws of the shortest rotation (``px4_*``, Brescianini, the Crazyflie's PID) have their largest torque there.
Letters: N start attitudes.
"""

from itertools import product

import torch
from torch import Tensor

from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.robot import InitialStateCfg, RobotCfg
from aerial_gym.control.controllers import Controller, make_controller
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.control.hover import hover_action, trim_axes
from aerial_gym.control.loop_check import refuse_or_warn
from aerial_gym.control.stateful import StatefulController
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics.law_memory import fresh_law_memory
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.physics.state import BodyState, state_at_rest
from aerial_gym.physics.vehicle import vehicle_from_config

GRID = 32  # Number of attitudes in each of roll and pitch; even, to avoid an equilibrium in the middle
INSET = 1e-3  # Distance of the outermost attitudes from the ends, in ranges, to avoid an equilibrium there
STILL = 1e-4  # Angular acceleration [rad/s²] below which a start counts as stuck: 10 s turn it by 0.3 degrees


def check_starts(
    robot: RobotCfg, controller: ControllerCfg, *, gravity: float, dt: float, names: tuple[str, str]
) -> None:
    """Refuse start attitudes of ``robot.initial_state`` from which the law does not recover.

    ``ControllerCfg.if_unstable = "warn"`` makes it a warning.

    Raises:
        ConfigError: If there are such attitudes.
    """
    if "roll" not in (trim_axes(controller) or ()):
        return
    attitudes = sample_attitudes(robot.initial_state)
    if len(attitudes) == 0:
        return
    stuck = int((recovery_acceleration(robot, controller, attitudes, gravity=gravity, dt=dt) < STILL).sum())
    if stuck:
        refuse_or_warn(
            controller,
            f"robot {names[0]} with controller {names[1]}: euler_low = {robot.initial_state.euler_low}, euler_high = "
            f"{robot.initial_state.euler_high} include starts that are tilted by more than 90 degrees. From {stuck} of "
            f"{len(attitudes)} such attitudes the law gives no torque about roll and pitch, and the vehicle falls as it is. "
            "Keep roll and pitch of initial_state (start of a task) below 90 degrees, or take a controller that turns over "
            "(px4_*, or lee_* with allocation 'prioritised'). "
            'dataclasses.replace(controller, if_unstable="warn") flies it as it is',
        )


def sample_attitudes(start: InitialStateCfg) -> Tensor:
    """Return the attitudes (N, 4), xyzw, of a grid in the start's roll and pitch that are tilted by more than 90 degrees."""
    roll, pitch = (_angle_grid(start.euler_low[i], start.euler_high[i]) for i in (0, 1))
    yaw = 0.5 * (start.euler_low[2] + start.euler_high[2])
    angles = torch.tensor([(r, p, yaw) for r, p in product(roll, pitch)], dtype=torch.float64)
    return quat_from_euler(angles[torch.cos(angles[:, 0]) * torch.cos(angles[:, 1]) < 0.0])


def recovery_acceleration(
    robot: RobotCfg, controller: ControllerCfg, attitudes: Tensor, *, gravity: float, dt: float
) -> Tensor:
    """Return a law's angular acceleration about roll and pitch [rad/s²], (N,), at attitudes (N, 4).

    The vehicle is at the setpoint of action 0, without velocity, and has the largest body rates of its start.
    """
    vehicle = vehicle_from_config(robot, num_envs=len(attitudes), dtype=torch.float64)
    law = make_controller(controller, vehicle, gravity, dt=dt, control=robot.control)
    state = state_at_rest(len(attitudes), vehicle.num_rotors, device=attitudes.device, dtype=attitudes.dtype)
    state.attitude[:] = attitudes
    state.ang_vel[:] = attitudes.new_tensor(robot.initial_state.ang_vel_high)
    thrust = rotor_thrust(vehicle, _steady_command(law, state))
    torque = (allocation_matrix(vehicle, gravity)[:, 3:] * thrust.unsqueeze(1)).sum(-1)
    return torch.linalg.solve(vehicle.inertia, torque)[:, :2].norm(dim=-1)


def _steady_command(law: Controller, state: BodyState) -> Tensor:
    """Return the rotor command (N, R) for a constant state, after all delays of the law."""
    action = hover_action(law, 0.0).to(state.position).expand(state.num_envs, -1)
    if not isinstance(law, StatefulController):
        return law.rotor_command(state, action)
    memory, timing = fresh_law_memory(law.needs, state.num_envs, state.position), law.timing
    for _ in range(timing.action_delay + timing.delay + timing.law):
        _, memory = law.command(state, action, memory)
    return law.command(state, action, memory)[0]


def _angle_grid(low: float, high: float) -> list[float]:
    low, high = low + INSET * (high - low), high - INSET * (high - low)
    return sorted({low + (high - low) * k / (GRID - 1) for k in range(GRID)})
