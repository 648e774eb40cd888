"""Actions as shares of a robot's rotor command range, so that one policy fits many vehicles.

Letters: R rotors.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import atan2, pi

import torch

from aerial_gym.config.checks import Vec3
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.config.task import TaskCfg
from aerial_gym.control.effectiveness import allocation_matrix
from aerial_gym.errors import ConfigError
from aerial_gym.physics import vehicle_from_config
from aerial_gym.physics.rotor_maps import rotor_state_for_thrust
from aerial_gym.task.terms.actions import ROTOR_RANGE

PLACE_DIGITS = 6  # Decimals of rotor directions [rad] for comparison: beyond float32 precision

FOUR = ((1.0, -1.0, -1.0, -1.0), (1.0, -1.0, 1.0, 1.0), (1.0, 1.0, 1.0, -1.0), (1.0, 1.0, -1.0, 1.0))
"""Effect of each rotor of a quadrotor, clockwise from the nose: lift, and torque about x, y and z; the first one turns
counterclockwise, as that of every quadrotor that comes with the package."""

POSSIBLE = 1e-6  # Relative error of a lift or torque that rotors can give


def with_rotor_range(cfg: TaskCfg, robot: RobotCfg, command: tuple[str, ...]) -> TaskCfg:
    """Return a task with the action ``rotor_range`` resolved for a robot; other tasks unchanged.

    An action of -1 and 1 is then the lowest and the highest command of a rotor, speed [rad/s] or thrust [N], and its
    entries belong to places (``rotor_order``). With ``params: {places: 4}`` a robot with another number of rotors,
    other spins or force mode takes the commands of a quadrotor: its rotors together give the lift and torque of those four
    (``quadrotor_to_rotors_matrix``).
    """
    if cfg.action.transform != ROTOR_RANGE:
        return cfg
    if cfg.action.params not in ({}, {"places": 4}):
        raise ConfigError(f"action {ROTOR_RANGE}: params {dict(cfg.action.params)}, expected {{places: 4}} or none")
    rotors_told = all(name.startswith(("speed", "thrust")) for name in command[: robot.num_rotors])
    if len(command) > robot.num_rotors and rotors_told:
        raise ConfigError(
            f"action {ROTOR_RANGE}: commands rotors alone; this robot also takes {', '.join(command[robot.num_rotors :])} of "
            "its driven joints. Choose a task with these, such as position_setpoint_task_reconfigurable"
        )
    ranges: list[tuple[float, float]] = []
    for name, rotor in zip(command, robot.rotor_types, strict=False):
        low, high = rotor.thrust_range
        if name.startswith("speed"):
            low, high = rotor_state_for_thrust(rotor, low), rotor_state_for_thrust(rotor, high)
        elif not name.startswith("thrust") or len(command) != robot.num_rotors:
            known = "no_control, rotor_speed_control"
            raise ConfigError(f"action {ROTOR_RANGE}: controller {cfg.controller} tells no rotors. Choose {known}")
        ranges.append((low, high))
    low, high = zip(*ranges, strict=True)
    order = rotor_order([mount.position for mount in robot.mounts.layout])
    spins = [spin for _, spin in sorted(zip(order, (mount.spin for mount in robot.mounts.layout), strict=True))]
    standard = spins == [1, -1, 1, -1] and all(rotor.mode == "speed" for rotor in robot.rotor_types)
    if cfg.action.params and not standard:
        rotors = zip(command, robot.rotor_types, strict=True)
        speeds = tuple(name.startswith("speed") and rotor.mode == "speed" for name, rotor in rotors)
        params = {"low": low, "high": high, "mix": quadrotor_to_rotors_matrix(robot), "speeds": speeds}
        return replace(cfg, action=replace(cfg.action, transform="four_places", params=params))
    params = {"low": low, "high": high, "order": order}
    return replace(cfg, action=replace(cfg.action, transform="affine", params=params))


def quadrotor_to_rotors_matrix(robot: RobotCfg) -> tuple[tuple[float, ...], ...]:
    """Return the mixing matrix (R, 4) from the four thrust shares of a quadrotor to the thrust shares of R rotors.

    Lift along body z and each torque use the least-squares thrusts without other components. Full lift is reached when the
    first rotor is at its limit, full torque when the root mean square of all is. For a quadrotor with square arms the
    matrix is the identity.
    """
    matrix = allocation_matrix(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), STANDARD_GRAVITY)[0]
    most = torch.tensor([rotor.thrust_range[1] for rotor in robot.rotor_types], dtype=matrix.dtype)
    wanted = torch.eye(6, dtype=matrix.dtype)[:, 2:]
    thrusts = torch.linalg.pinv(matrix) @ wanted
    size = matrix.norm(dim=1, keepdim=True).clamp_min(matrix.norm() * POSSIBLE)
    missed = ((matrix @ thrusts - wanted) / size).abs().amax(0) * size[2:, 0]
    if bool((missed > POSSIBLE).any()):
        raise ConfigError(
            f"action {ROTOR_RANGE}: the rotors cannot lift this robot and turn it about each axis by itself, as those of a "
            "quadrotor can"
        )
    shares = thrusts / most.unsqueeze(1)
    shares = shares / torch.cat((shares[:, :1].abs().amax(0), shares[:, 1:].square().mean(0).sqrt()))
    mixing = shares @ torch.tensor(FOUR, dtype=matrix.dtype).T / 4.0
    return tuple(map(tuple, mixing.tolist()))


def rotor_order(positions: Sequence[Vec3]) -> tuple[int, ...]:
    """Return the number of each rotor, counted clockwise as seen from above from the nose on, by positions [m], body."""
    turns = [round(atan2(-y, x) % (2.0 * pi), PLACE_DIGITS) % round(2.0 * pi, PLACE_DIGITS) for x, y, _ in positions]
    counted = sorted(range(len(turns)), key=turns.__getitem__)
    return tuple(counted.index(rotor) for rotor in range(len(turns)))
