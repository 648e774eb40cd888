"""The body of a robot class: mass, inertia and shapes of its URDF, rotors of its allocation matrix.

A column of the matrix is force and torque per thrust of a rotor: its axis a, and ``r x a - d c a`` with its place r, its
direction d and torque ratio c. The place along the axis changes nothing and is that of the origin.
"""

from pathlib import Path

import numpy as np

from aerial_gym.assets.urdf import load_urdf, urdf_body
from aerial_gym.compat.config.fields import Changes, Values, values_equal
from aerial_gym.compat.helpers import AERIAL_GYM_DIRECTORY
from aerial_gym.config.robot import BodyCfg, MountCfg, MountsCfg, RobotCfg, Vec3
from aerial_gym.errors import ConfigError
from aerial_gym.robots.importers.file_vehicle import make_collision, part_collision_shape

FOLDER = f"{AERIAL_GYM_DIRECTORY}/resources/robots/quad"
"""URDF folder in a class generated from a robot of this package; it need not exist."""

MATRIX, DIRECTIONS = "control_allocator_config.allocation_matrix", "control_allocator_config.motor_directions"
_MOTORS = "control_allocator_config.num_motors"
_RATIO = "control_allocator_config.motor_model_config.thrust_to_torque_ratio"


def allocation_matrix(cfg: RobotCfg) -> list[list[float]]:
    """Return force and torque per thrust of each rotor, rows Fx, Fy, Fz, Mx, My, Mz, columns in the order of the mounts."""
    columns = []
    for mount, rotor in zip(cfg.mounts.layout, cfg.rotor_types, strict=True):
        axis = np.asarray(mount.axis, dtype=float) / np.linalg.norm(mount.axis)
        torque = np.cross(mount.position, axis) - mount.spin * (rotor.torque_ratio or 0.0) * axis
        columns.append(np.concatenate((axis, torque)))
    return np.stack(columns, axis=1).tolist()


def rotor_changes(values: Values) -> Changes:
    """Return the mounts of an allocation matrix."""
    matrix = np.asarray(values[MATRIX], dtype=float)
    directions, ratio = [int(d) for d in values[DIRECTIONS]], float(values[_RATIO])
    if matrix.shape != (6, len(directions)) or int(values[_MOTORS]) != len(directions):
        raise ConfigError(
            f"{MATRIX} of shape {matrix.shape}: needs a column for each of the {values[_MOTORS]} motors and of the "
            f"{len(directions)} motor_directions"
        )
    layout = tuple(
        _mount_of_column(column, spin, ratio, i)
        for i, (column, spin) in enumerate(zip(matrix.T, directions, strict=True))
    )
    return {"mounts": MountsCfg(layout=layout, source=f"{MATRIX} of a robot class")}


def _mount_of_column(column: np.ndarray, spin: int, ratio: float, number: int) -> MountCfg:
    force, torque = column[:3], column[3:]
    size = float(np.linalg.norm(force))
    if not np.isclose(size, 1.0, rtol=1e-3):
        raise ConfigError(f"{MATRIX}, motor {number}: force {force.tolist()} per thrust has the size {size:g}, not 1")
    axis = force / size
    along = float(torque @ axis)
    if not np.isclose(along, -spin * ratio, rtol=1e-2, atol=1e-6):
        raise ConfigError(
            f"{MATRIX}, motor {number}: torque {along:g} about its axis per thrust, but motor_directions and "
            f"thrust_to_torque_ratio say {-spin * ratio:g}. There the matrix allocates and the others act; say one thing"
        )
    place = np.cross(axis, torque)
    return MountCfg(position=_vec3(place), axis=_vec3(axis), spin=spin)


def body_changes(values: Values) -> Changes:
    """Return mass, inertia and collision shapes of a class's URDF; nothing if it names a robot of this package."""
    folder, file = str(values["robot_asset.asset_folder"]), str(values["robot_asset.file"])
    path = Path(folder) / file
    if values_equal(folder, FOLDER) and not path.is_file():
        return {}
    if not path.is_file():
        raise ConfigError(
            f"robot_asset {path}: no such URDF file; those of that simulator are not here. Give your own, "
            "or a robot file (.yaml) as robot_name"
        )
    whole, source = urdf_body(path), f"URDF {path.name}, all links at zero joint angles"
    inertia = (_vec3(whole.inertia[0]), _vec3(whole.inertia[1]), _vec3(whole.inertia[2]))
    return {
        "body": BodyCfg(mass=whole.mass, inertia=inertia, com=_vec3(whole.com), source=source),
        "collision": make_collision(
            [part_collision_shape(part) for part in load_urdf(path).parts or ()], f"URDF {path.name}"
        ),
        "summary": f"robot of {path.name}",
    }


def _vec3(vector: np.ndarray) -> Vec3:
    x, y, z = map(float, vector)
    return x, y, z
