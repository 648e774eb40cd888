"""Joint efforts in a flight with logged joint angles, by inverse dynamics of the declared links.

The efforts are the joint rows of ``M a + h = f`` for the measured motion and rotor thrusts. All signals pass the same low-pass
twice, so derivatives have the same band. Letters: T rows, D joints.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.errors import DataError
from aerial_gym.math.quaternion import quat_normalize, quat_rotate_inverse
from aerial_gym.physics import build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.flight import link_damping, link_fluid, link_wrenches
from aerial_gym.physics.articulated.link_loads import add_fluid
from aerial_gym.physics.articulated.tree import Links, TreeState
from aerial_gym.physics.model import Model, robot_effects
from aerial_gym.physics.rotor_lag import follow_command, vehicle_lag
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.logs.readers.csv_table import read_csv_rows
from aerial_gym.sim2real.logs.readers.mapping import find_mapping
from aerial_gym.sim2real.logs.recording import FlightLog, split_flight_number
from aerial_gym.sim2real.logs.signals import interpolate_columns, log_at_equal_steps, lowpass, num_edge_rows

SLOW = 0.05  # Velocity scale v of dry friction, as a share of the joint rate's standard deviation


@dataclass(frozen=True, kw_only=True)
class JointMotion:
    """Motion and efforts of the joints in one flight."""

    name: str
    angle: Array  # Joint angles [rad], (T, D)
    rate: Array  # Joint rates [rad/s], (T, D)
    side: Array  # Low-passed direction of motion, -1 to 1, (T, D)
    effort: Array  # Joint efforts from inverse dynamics [N m], (T, D)


def read_joint_motion(flight: FlightLog, robot: RobotCfg, *, bandwidth: float) -> JointMotion:
    """Return the joint motion and efforts of a flight from a CSV file in the package's own layout.

    The file has columns ``joint_NAME``, or ``joint_1`` to ``joint_D``, with angles [rad] or displacements [m].
    """
    assert robot.joints is not None
    path = split_flight_number(flight.path)[0]
    table, _, _ = read_csv_rows(Path(path), find_mapping("aerial_gym"), [])
    table = table.loc[flight.lines]
    columns = []
    for number, name in enumerate(robot.joints.names, 1):
        known = [column for column in (f"joint_{name}", f"joint_{number}") if column in table.columns]
        if not known:
            raise DataError(
                f"{path}: has no angle of the joint {name}; add a column joint_{name}, or joint_{number} [rad]"
            )
        columns.append(known[0])
    angles = np.asarray(table[columns].apply(pd.to_numeric, errors="coerce"), dtype=float)
    if not np.isfinite(angles).all():
        raise DataError(f"{path}: joint angles have empty or non-numeric fields; cut the log, or fill them")
    log = log_at_equal_steps(flight)
    return joint_motion(robot, log, interpolate_columns(log.time, flight.time, angles), bandwidth=bandwidth)


def joint_motion(robot: RobotCfg, log: FlightLog, angle: Array, *, bandwidth: float) -> JointMotion:
    """Return the joint motion and efforts for logged joint angles [rad], (T, D)."""
    rate = require_rate(log, bandwidth)
    assert log.ang_vel is not None

    def slow(values: Array, *, derivatives: int = 0) -> Array:
        first = lowpass(values, rate, bandwidth, derivative=derivatives > 0)
        return lowpass(first, rate, bandwidth, derivative=derivatives > 1)

    def rows(values: Array) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(values))

    attitude = quat_normalize(rows(slow(log.attitude)))
    down = quat_rotate_inverse(attitude, torch.tensor((0.0, 0.0, -STANDARD_GRAVITY)).double().expand(len(attitude), 3))
    if log.specific_force is not None:
        lin_acc = rows(slow(log.specific_force)) + down
    else:
        assert log.lin_vel is not None
        lin_acc = quat_rotate_inverse(attitude, rows(slow(log.lin_vel, derivatives=1)))
    lin_vel = torch.zeros_like(lin_acc) if log.lin_vel is None else rows(slow(log.lin_vel))
    state = TreeState(
        position=torch.zeros_like(lin_acc) if log.position is None else rows(slow(log.position)),
        attitude=attitude,
        lin_vel=lin_vel,
        ang_vel=rows(slow(log.ang_vel)),
        joint_pos=rows(slow(angle)),
        joint_vel=rows(slow(angle, derivatives=1)),
    )
    acc = torch.cat((lin_acc, rows(slow(log.ang_vel, derivatives=1)), rows(slow(angle, derivatives=2))), dim=-1)
    effort = joint_efforts(robot, state, rows(slow(rotor_states(robot, log))), acc)
    wide = lowpass(angle, rate, rate / 5.0, derivative=True)
    side = slow(wide / np.sqrt(wide**2 + (SLOW * wide.std(axis=0)) ** 2 + 1e-30))
    edge = 2 * num_edge_rows(rate, bandwidth)
    kept = slice(edge, len(angle) - edge)
    if len(angle) <= 4 * edge:
        raise DataError(f"{log.path}: {len(angle)} rows are too few for a bandwidth of {bandwidth:g} Hz")
    angles, rates, efforts = (values.numpy()[kept] for values in (state.joint_pos, state.joint_vel, effort))
    return JointMotion(name=log.name, angle=angles, rate=rates, side=side[kept], effort=efforts)


def require_rate(log: FlightLog, bandwidth: float) -> float:
    """Return the sample rate of a log; raise ``DataError`` if it is too low or the body's motion is missing."""
    rate = 1.0 / float(np.median(np.diff(log.time)))
    if rate < 5.0 * bandwidth:
        raise DataError(
            f"{log.path}: {rate:.4g} rows per second; a bandwidth of {bandwidth:g} Hz needs five times that"
        )
    if log.ang_vel is None or (log.specific_force is None and log.lin_vel is None):
        raise DataError(f"{log.path}: needs omega, and acc or v, for the efforts of the joints")
    return rate


def joint_efforts(robot: RobotCfg, state: TreeState, rotors: torch.Tensor, acc: torch.Tensor) -> torch.Tensor:
    """Return the joint efforts (T, D) for a motion and its accelerations (T, 6 + D), by inverse dynamics."""
    model, links, wrench = apply_link_wrenches(robot, state, rotors)
    articulation = model.articulation
    assert articulation is not None
    damping = link_damping(model, articulation, links, state)
    if damping is not None:
        wrench = wrench + damping.start_wrench(links)
    results = equations_of_motion(articulation.tree, links, state, gravity=STANDARD_GRAVITY, wrench=wrench)
    fluid = link_fluid(model, links, state)
    if fluid is not None:
        results = add_fluid(articulation.tree, results, state.attitude, fluid)
    return ((results.mass @ acc.unsqueeze(-1)).squeeze(-1) - results.force)[:, 6:]


def apply_link_wrenches(robot: RobotCfg, state: TreeState, rotors: torch.Tensor) -> tuple[Model, Links, torch.Tensor]:
    """Return the articulated model, its links, and the wrenches of rotors and effects on each link, (T, L, 6).

    Link drag and entrained fluid are excluded, as they depend on further quantities.
    """
    num_rows = len(rotors)
    vehicle = vehicle_from_config(robot, num_envs=num_rows, dtype=torch.float64)
    effects = robot_effects(robot, num_envs=num_rows, device=torch.device("cpu"), dtype=torch.float64)
    articulation = build_articulation(robot, like=vehicle.mass)
    assert articulation is not None
    model = build_model(vehicle, effects, gravity=STANDARD_GRAVITY, ceiling_height=1e3, articulation=articulation)
    wrench = link_wrenches(model, articulation, state, rotors, torch.zeros_like(rotors))
    return model, articulation.links(model.vehicle), wrench


def rotor_states(robot: RobotCfg, log: FlightLog) -> Array:
    """Return the measured rotor states (T, R), or the commands with the declared lag."""
    if log.rotor_speed is not None:
        return log.rotor_speed
    if log.rotor_command is None:
        raise DataError(f"{log.path}: holds neither speeds nor commands of the rotors")
    if log.relative_commands:
        raise DataError(
            f"{log.path}: its commands are shares of the largest speed; map rotor_command with a gain in rad/s"
        )
    vehicle = vehicle_from_config(robot, num_envs=1, dtype=torch.float64)
    command = torch.from_numpy(log.rotor_command).unsqueeze(1)
    state, results, step = command[0], [], float(np.median(np.diff(log.time)))
    for row in command:
        results.append(state[0])
        state = follow_command(vehicle_lag(vehicle), state, row, step)
    return torch.stack(results).numpy()
