"""Robots: classes with ``init_config``, ``sensor_config``, ``robot_asset`` and ``control_allocator_config`` inside.

A column of the allocation matrix is force and torque per thrust of a rotor: its axis a, and ``r x a - d c a`` with its place r,
its direction d and torque ratio c. The place along the axis changes nothing and is that of the origin.

That simulator has mass, inertia and geometry in URDF files; this package in a robot file, from which the allocation matrix
is derived. A class modifies the robot whose URDF it names, else that of its nearest generated ancestor; with a URDF and an
allocation matrix of its own it replaces the body. Thrust constants change from per (rev/s)² to per (rad/s)².
"""

import logging
from collections.abc import Sequence
from dataclasses import replace
from math import pi
from pathlib import Path
from typing import Any

import numpy as np

from aerial_gym.assets.urdf import load_urdf, urdf_body
from aerial_gym.compat.config.fields import (
    STANDS_FOR,
    Changes,
    ConfigTable,
    Values,
    class_only_field,
    idle_field,
    log_once,
    native_field,
    replace_config_entries,
    unchangeable_field,
    values_equal,
)
from aerial_gym.compat.config.imus import imu_catalog_name, imu_class
from aerial_gym.compat.config.sensors import sensor_catalog_name, sensor_class
from aerial_gym.compat.helpers import AERIAL_GYM_DIRECTORY
from aerial_gym.config.robot import BodyCfg, MountCfg, MountsCfg, RobotCfg, Vec3
from aerial_gym.config.sensor import LidarCfg
from aerial_gym.config.sensor_mount import as_mounts
from aerial_gym.errors import ConfigError
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.importers.file_vehicle import make_collision, part_collision_shape
from aerial_gym.sensors import IMUS, SENSORS

FOLDER = f"{AERIAL_GYM_DIRECTORY}/resources/robots/quad"  # URDF folder in classes of our robots; it need not exist
STANDARD_FILES: dict[str, str] = {
    "quad/quad.urdf": "base_quadrotor", "quad/model.urdf": "base_quad_root_link_control",
    "octarotor/octarotor.urdf": "base_octarotor", "random/random.urdf": "base_random", "BlueROV/rov.urdf": "base_rov",
    "tinyprop/tinyprop.urdf": "tinyprop", "morphy/morphy.urdf": "morphy", "morphy/morphy_stiff.urdf": "morphy_stiff",
    **{f"{name}/model.urdf": name for name in ("lmf1", "lmf2", "magpie", "x500", "snakey", "snakey5", "snakey6")},
}  # fmt: skip
"""Folder and URDF file that come with that simulator, and the robot here."""

MATRIX, DIRECTIONS = "control_allocator_config.allocation_matrix", "control_allocator_config.motor_directions"
_LEVEL = "control_allocator_config.force_application_level"
_FOLDER, _FILE, _FIXED = "robot_asset.asset_folder", "robot_asset.file", "robot_asset.fix_base_link"
_JOINTS = "reconfiguration_config"
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
    """Return the mounts of an allocation matrix; for a robot of this package whose links carry the motors, its own ones with
    the directions of the class, because forces act on the links there too."""
    matrix, cfg = np.asarray(values[MATRIX], dtype=float), values[STANDS_FOR]
    directions, ratio = [int(d) for d in values[DIRECTIONS]], float(values[_RATIO])
    on_links = values[_LEVEL] == "motor_link" and not _urdf_path(values).is_file()
    if (on_links or cfg.joints) and int(values[_MOTORS]) == len(directions) == cfg.num_rotors:
        turned = zip(cfg.mounts.layout, directions, strict=True)
        mounts = replace(cfg.mounts, layout=tuple(replace(mount, spin=spin) for mount, spin in turned))
        if not values_equal(matrix, allocation_matrix(replace(cfg, mounts=mounts))):
            remedy = "" if cfg.joints else f'; {_LEVEL} = "root_link" lets the matrix place them'
            log_once(
                f"{_urdf_path(values)}: allocation_matrix differs from the rotors of the robot and is without effect here: "
                f"the controller's matrix follows from the rotors{remedy}",
                logging.WARNING,
            )
        return {"mounts": mounts}
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
    path = _urdf_path(values)
    if not path.is_file():
        if _standard_robot(path) or path == Path(FOLDER, _urdf_file(values[STANDS_FOR])):
            return {}
        raise ConfigError(
            f"robot_asset {path}: no such URDF file. Those of that simulator are not here, but these names stand for the same "
            f"robots: {', '.join(STANDARD_FILES)}. Give one of them, your own URDF, or a robot file (.yaml) as robot_name"
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


def _urdf_path(values: Values) -> Path:
    return Path(str(values[_FOLDER]), str(values[_FILE]))


def _standard_robot(path: Path) -> str | None:
    """Return the robot here for a URDF file of that simulator."""
    return STANDARD_FILES.get("/".join(path.parts[-2:]))


def _vec3(vector: np.ndarray) -> Vec3:
    x, y, z = map(float, vector)
    return x, y, z


_NEVER_ACTIVE = 100000.0  # Largest rate of a motor there if none is wanted
_PER_TURN = (2.0 * pi) ** 2  # (rad/s)² per (rev/s)²


def _initial_state(cfg: RobotCfg, end: str) -> list[float]:
    start = cfg.initial_state
    parts = (getattr(start, f"{name}_{end}") for name in ("position_ratio", "euler"))
    speeds = (getattr(start, f"{name}_{end}") for name in ("lin_vel", "ang_vel"))
    return [*(n for part in parts for n in part), 1.0, *(n for part in speeds for n in part)]


def _initial_state_changes(end: str) -> Any:
    def write(values: Values) -> Changes:
        state = values[f"init_config.{'min' if end == 'low' else 'max'}_init_state"]
        cuts = {"position_ratio": (0, 3), "euler": (3, 6), "lin_vel": (7, 10), "ang_vel": (10, 13)}
        return {f"initial_state.{name}_{end}": tuple(float(n) for n in state[a:b]) for name, (a, b) in cuts.items()}

    return write


_MOTOR = "control_allocator_config.motor_model_config"
_RANGE = "the middle of the range; draws are `randomize:` of a robot file"


def _middle_of_range(values: Values, name: str) -> float:
    """Return the middle of a range of the motor model."""
    return 0.5 * (values[f"{_MOTOR}.{name}_min"] + values[f"{_MOTOR}.{name}_max"])


def _thrust_map_changes(values: Values) -> Changes:
    """Return the mode of the rotors and their thrust map, None in force mode."""
    if not values[f"{_MOTOR}.use_rps"]:
        return {"rotor.mode": "force", "rotor.thrust_map": (0.0, 0.0, 0.0)}
    constant, own = _middle_of_range(values, "motor_thrust_constant"), values[STANDS_FOR].rotor_types[0].thrust_map[2]
    unchanged = np.isclose(constant, own, rtol=1e-6, atol=0.0)  # PX4's constants, which are per (rad/s)² there too
    return {"rotor.mode": "speed", "rotor.thrust_map": (0.0, 0.0, own if unchanged else constant / _PER_TURN)}


def _slew_rate_changes(values: Values) -> Changes:
    """Return the largest rate of the state: there [rev/s²] or [N/s]."""
    rate = float(values[f"{_MOTOR}.max_thrust_rate"])
    return {"rotor.slew_rate": 2.0 * pi * rate if values[f"{_MOTOR}.use_rps"] else rate}


def _script_slew_rate(cfg: RobotCfg) -> float:
    rotor = cfg.rotor_types[0]
    if rotor.slew_rate is None:
        return _NEVER_ACTIVE
    return rotor.slew_rate / (2.0 * pi) if rotor.mode == "speed" else rotor.slew_rate


_EFFECTS_SOURCE = "damping and disturbance of a robot class"
_PUSH = "disturbance"
_PUSH_NAMES = tuple(f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz")


def _push_effect(probability: float, box: Sequence[float]) -> dict[str, float]:
    """Return the effect of pushes drawn in each physics step: its shortest interval is below every step."""
    return dict(zip(_PUSH_NAMES, map(float, box), strict=True)) | {"probability": float(probability), "hold": 0.0001}


_SMALL_PUSH = _push_effect(0.02, [0.75] * 3 + [0.004] * 3)
_PUSHES = {
    **dict.fromkeys(("base_octarotor", "base_random", "base_rov"), _push_effect(0.05, [1.5] * 3 + [0.25] * 3)),
    **dict.fromkeys(("lmf2_with_camera", "lmf2_radar", "magpie"), _push_effect(0.05, [4.75] * 3 + [0.03] * 3)),
    **dict.fromkeys(("morphy_stiff", "snakey", "snakey5", "snakey6"), _SMALL_PUSH),
}
"""Pushes of the robots that have them in that simulator."""


def _robot_with_pushes(name: str) -> RobotCfg:
    """Return a registered robot with the pushes that it has in that simulator."""
    cfg = ROBOTS.get(name)
    if name not in _PUSHES:
        return cfg
    return replace_config_entries(cfg, {"effects_source": _EFFECTS_SOURCE, "effects.random_push": _PUSHES[name]})


def _push_changes(values: Values) -> Changes:
    """Return the effect of the pushes, with the probability 0 where a class turns off those of its robot."""
    enabled = values[f"{_PUSH}.enable_disturbance"]
    if not enabled and "random_push" not in values[STANDS_FOR].effects:
        return {}
    probability = values[f"{_PUSH}.prob_apply_disturbance"] if enabled else 0.0
    push = _push_effect(probability, values[f"{_PUSH}.max_force_and_torque_disturbance"])
    return {"effects_source": _EFFECTS_SOURCE, "effects.random_push": push}


def _drag_changes(values: Values) -> Changes:
    """Return the drag effects of the damping coefficients; the same laws."""
    changes: Changes = {"effects_source": _EFFECTS_SOURCE}
    for name, order in (("rotor_drag", "linear"), ("quadratic_drag", "quadratic")):
        coefficients = values[f"damping.linvel_{order}_damping_coefficient"]
        if any(coefficients):
            changes[f"effects.{name}"] = dict(zip(("dx", "dy", "dz"), map(float, coefficients), strict=True))
    return changes


def _sensor_changes(values: Values) -> Changes:
    names = (("camera", sensor_catalog_name), ("lidar", sensor_catalog_name), ("imu", imu_catalog_name))
    on_board = [
        name(values[f"sensor_config.{kind}_config"]) for kind, name in names if values[f"sensor_config.enable_{kind}"]
    ]
    return {"sensors": tuple(on_board), "imu": None}


def _imu_class(cfg: RobotCfg, default: str | None) -> type | None:
    """Return the class of the first IMU that a robot has."""
    imu = next((mount.sensor for mount in cfg.sensor_mounts if mount.sensor in IMUS), default)
    return None if imu is None else imu_class(imu)


def _sensor_class(cfg: RobotCfg, kind: str, default: str | None) -> type | None:
    """Return the class of the first sensor of a kind, camera or lidar, that a robot has."""
    for mount in cfg.sensor_mounts:
        if mount.sensor in SENSORS and isinstance(SENSORS.get(mount.sensor), LidarCfg) == (kind == "lidar"):
            return sensor_class(mount.sensor)
    return None if default is None else sensor_class(default)


def _urdf_file(cfg: RobotCfg) -> str:
    return "quad.urdf" if cfg.body == ROBOTS.get("base_quadrotor").body else "robot.urdf"


def _drag_coefficients(cfg: RobotCfg, effect: str) -> list[float]:
    given = cfg.effects.get(effect, {})
    return [given.get(name, 0.0) for name in ("dx", "dy", "dz")]


def _joint_values(cfg: RobotCfg, read: Any) -> list[Any]:
    return [read(joint) for joint in cfg.joints.layout] if cfg.joints else []


def _drive_mode(cfg: RobotCfg) -> str:
    """Return the mode of the drives; ``effort`` for joints without any, ``none`` for a robot without joints."""
    drives = [joint.drive for joint in (cfg.joints.layout if cfg.joints else ()) if joint.drive]
    return drives[0].mode if drives else "effort" if cfg.joints else "none"


def _apply_joints(cfg: RobotCfg, given: Values) -> RobotCfg:
    """Return a robot with the joint states, drive gains and held base of a class."""
    fields = [field for field in TABLE.fields if field.script_name.startswith((_JOINTS, _FIXED))]
    own: dict[str, Any] = {field.script_name: field.read(cfg) for field in fields}
    changed = {name: given[name] for name in own if name in given and not values_equal(given[name], own[name])}
    if not changed:
        return cfg
    told = ", ".join(f"{name} = {value!r}" for name, value in changed.items())
    if cfg.joints is None:
        raise ConfigError(
            f"{told}: this robot has no joints here. aerial-gym robot import --joints writes a robot file with those of a "
            "URDF; give it as robot_name"
        )
    names = ("init_state_min", "init_state_max", "stiffness", "damping")
    low, high, stiffness, damping = ((own | changed)[f"{_JOINTS}.{name}"] for name in names)
    rows, count = [*low, *high, stiffness, damping], len(cfg.joints.layout)
    if f"{_JOINTS}.dof_mode" in changed or len(rows) != 6 or any(len(row) != count for row in rows):
        raise ConfigError(
            f"{told}: joints of this robot are driven in mode {_drive_mode(cfg)!r}, and each row needs {count} entries. "
            "Name the URDF of another robot, or give a robot file with `joints:` as robot_name"
        )
    layout = []
    for joint, q_low, rate_low, q_high, rate_high, gain, drive_damping in zip(cfg.joints.layout, *rows, strict=True):
        drive = joint.drive
        if drive and drive.mode != "effort":
            drive = replace(drive, stiffness=float(gain), damping=float(drive_damping))
        ranges = {"initial": (float(q_low), float(q_high)), "initial_rate": (float(rate_low), float(rate_high))}
        layout.append(replace(joint, drive=drive, **ranges))
    floating = not (own | changed)[_FIXED]
    return replace(cfg, joints=replace(cfg.joints, layout=tuple(layout), floating=floating))


_VISUAL = "`visual:` of a robot file"
_NO_SENSOR = "no sensor of forces on links"
_START = "init_config says where a robot starts"

TABLE = ConfigTable(
    kind="robot",
    fields=(
        native_field("init_config.min_init_state", "initial_state.*_low", lambda c: _initial_state(c, "low"),
                _initial_state_changes("low"),
                "shares of the bounds, roll, pitch, yaw, a 1, velocity, angular velocity (body axes)"),
        native_field("init_config.max_init_state", "initial_state.*_high", lambda c: _initial_state(c, "high"),
                _initial_state_changes("high")),
        native_field("sensor_config.enable_camera", "sensors", lambda c: _sensor_class(c, "camera", None) is not None,
                _sensor_changes, "a camera and a lidar together work here"),
        native_field("sensor_config.camera_config", "sensors", lambda c: _sensor_class(c, "camera", "base_depth_camera"),
                     _sensor_changes),
        native_field("sensor_config.enable_lidar", "sensors", lambda c: _sensor_class(c, "lidar", None) is not None,
                _sensor_changes),
        native_field("sensor_config.lidar_config", "sensors", lambda c: _sensor_class(c, "lidar", "base_lidar"),
                _sensor_changes),
        native_field("sensor_config.enable_imu", "sensors", lambda c: _imu_class(c, None) is not None, _sensor_changes),
        native_field("sensor_config.imu_config", "sensors", lambda c: _imu_class(c, "base_imu"), _sensor_changes),
        *(native_field(f"{_PUSH}.{name}", "effects.random_push", read, _push_changes, remark) for name, read, remark in (
            ("enable_disturbance", lambda c: "random_push" in c.effects,
             "drawn in each physics step, as there, so the effect depends on dt; it acts at the centre of mass"),
            ("prob_apply_disturbance", lambda c: c.effects.get("random_push", _SMALL_PUSH)["probability"], ""),
            ("max_force_and_torque_disturbance",
             lambda c: [c.effects.get("random_push", _SMALL_PUSH)[name] for name in _PUSH_NAMES], ""),
        )),
        native_field("damping.linvel_linear_damping_coefficient", "effects.rotor_drag",
                lambda c: _drag_coefficients(c, "rotor_drag"), _drag_changes),
        native_field("damping.linvel_quadratic_damping_coefficient", "effects.quadratic_drag",
                lambda c: _drag_coefficients(c, "quadratic_drag"), _drag_changes),
        unchangeable_field("damping.angular_linear_damping_coefficient", [0.0] * 3,
                "there is no such effect here yet; 0 is what all robots have"),
        unchangeable_field("damping.angular_quadratic_damping_coefficient", [0.0] * 3,
                "there is no such effect here yet; 0 is what all robots have"),
        native_field(_FOLDER, "body, collision", lambda _: FOLDER, body_changes,
                "a URDF: all links as one body about their centre of mass; its spheres and boxes, boxes around the rest. Those "
                "of that simulator stand for the same robots here"),
        native_field(_FILE, "body, collision", _urdf_file, body_changes),
        class_only_field(_FIXED, "joints: floating", lambda c: c.joints is not None and not c.joints.floating,
                "of robots with joints alone"),
        class_only_field("robot_asset.disable_gravity", "gravity: 0 of the sim", lambda _: False, "of robots alone there"),
        *(idle_field(f"robot_asset.{name}", value, why) for name, value, why in (
            ("name", "base_quadrotor", "the registered name"), ("base_link_name", "base_link", "a robot is one body"),
            ("collision_mask", 0, "PhysX"), ("replace_cylinder_with_capsule", False, "PhysX"),
            ("flip_visual_attachments", True, "PhysX"), ("density", 0.000001, "PhysX"), ("angular_damping", 0.01, "PhysX"),
            ("linear_damping", 0.01, "PhysX"), ("max_angular_velocity", 100.0, "PhysX"),
            ("max_linear_velocity", 100.0, "PhysX"), ("armature", 0.001, "PhysX"),
            ("collapse_fixed_joints", True, "PhysX"), ("use_mesh_materials", False, _VISUAL), ("semantic_id", 0, _VISUAL),
            ("per_link_semantic", False, _VISUAL), ("semantic_masked_links", {}, _VISUAL),
            ("keep_in_env", True, "a robot is always there"), ("color", None, _VISUAL),
            ("place_force_sensor", False, _NO_SENSOR), ("force_sensor_parent_link", "base_link", _NO_SENSOR),
            ("force_sensor_transform", None, _NO_SENSOR), ("use_collision_mesh_instead_of_visual", False, _VISUAL),
            ("min_state_ratio", None, _START), ("max_state_ratio", None, _START), ("min_position_ratio", None, _START),
            ("max_position_ratio", None, _START), ("min_euler_angles", None, _START), ("max_euler_angles", None, _START),
            ("max_force_and_torque_disturbance", None, "read nowhere there either"),
        )),
        *(idle_field(f"init_config.{name}", None, "min_init_state and max_init_state say where a robot starts")
          for name in ("min_state_ratio", "max_state_ratio")),
        native_field(MATRIX, "mounts", allocation_matrix, rotor_changes,
                "with an own URDF, or on root_link, the rotors stand where the matrix has them; it is derived from them again"),
        native_field("control_allocator_config.num_motors", "mounts", lambda c: c.num_rotors, rotor_changes),
        native_field(DIRECTIONS, "mounts: spin", lambda c: [m.spin for m in c.mounts.layout], rotor_changes,
                "matrix and directions must say the same where the matrix places the rotors"),
        idle_field("control_allocator_config.application_mask", None, "thrust acts where the rotors are"),
        class_only_field(_LEVEL, "mounts", lambda _: "motor_link", "says whether URDF or matrix places the rotors"),
        native_field(f"{_MOTOR}.use_rps", "rotor.mode", lambda c: c.rotor_types[0].mode == "speed", _thrust_map_changes,
                "speed or force"),
        *(native_field(f"{_MOTOR}.motor_thrust_constant_{end}", "rotor.thrust_map",
                  lambda c: c.rotor_types[0].thrust_map[2] * _PER_TURN, _thrust_map_changes, f"N per (rev/s)²; {_RANGE}")
          for end in ("min", "max")),
        *(native_field(f"{_MOTOR}.motor_time_constant_{way}_{end}", f"rotor.{native}",
                  lambda c, n=native: getattr(c.rotor_types[0], n),
                  lambda v, way=way, n=native: {f"rotor.{n}": _middle_of_range(v, f"motor_time_constant_{way}")}, remark)
          for way, native, remark in (
              ("increasing", "time_constant_up", f"{_RANGE}; there the lag was tau + dt"),
              ("decreasing", "time_constant_down", _RANGE),
          )
          for end in ("min", "max")),
        *(native_field(f"{_MOTOR}.{end}_thrust", "rotor.thrust_range",
                  lambda c, place=place: c.rotor_types[0].thrust_range[place],
                  lambda v: {"rotor.thrust_range": tuple(float(v[f"{_MOTOR}.{end}_thrust"]) for end in ("min", "max"))})
          for place, end in enumerate(("min", "max"))),
        native_field(f"{_MOTOR}.thrust_to_torque_ratio", "rotor.torque_ratio", lambda c: c.rotor_types[0].torque_ratio,
                lambda v: {"rotor.torque_ratio": float(v[f"{_MOTOR}.thrust_to_torque_ratio"]), "rotor.torque_map": None}),
        native_field(f"{_MOTOR}.max_thrust_rate", "rotor.slew_rate", _script_slew_rate, _slew_rate_changes, "100000 is none"),
        idle_field(f"{_MOTOR}.use_discrete_approximation", True, "the lag is exact for every dt"),
        idle_field(f"{_MOTOR}.integration_scheme", "rk4", "the lag is exact for every dt"),
        class_only_field("dof_control_mode", "-", lambda _: "none", "each drive has its own mode"),
        class_only_field(f"{_JOINTS}.dof_mode", "joints: drive: mode", _drive_mode, "snakes have robots of all three"),
        *(class_only_field(f"{_JOINTS}.init_state_{there}", "joints: initial, initial_rate",
                lambda c, end=end: [_joint_values(c, lambda j, name=name: getattr(j, name)[end])
                                    for name in ("initial_range", "initial_rate")],
                "a row of coordinates, a row of rates")
          for end, there in enumerate(("min", "max"))),
        *(class_only_field(f"{_JOINTS}.{name}", f"joints: drive: {name}",
                lambda c, name=name: _joint_values(c, lambda j: getattr(j.drive, name, 0.0)), "without effect in effort mode")
          for name in ("stiffness", "damping")),
        *(unchangeable_field(f"{_JOINTS}.{name}", value, "the law of the arms is `spring:` of a joint in a robot file")
          for name, value in (("custom_nonlinear_stiffness", -230.0), ("custom_linear_damping", -5834.0))),
    ),
    idle_sections={"reset_asset": "-"},
)  # fmt: skip
"""Translation of the attributes of a robot class."""


def has_no_gravity(cls: Any) -> bool:
    """Return whether a robot class feels no gravity."""
    return bool(TABLE.values(cls).get("robot_asset.disable_gravity", False))


def translate_robot(cls: Any) -> RobotCfg:
    """Return our robot for a robot class; sensor classes are changed in place by scripts, so they are read at every call."""
    given = TABLE.values(cls)
    cfg = _apply_joints(TABLE.translate(cls, None, base=_base_robot(cls, given)), given)
    values = {field.script_name: field.read(cfg) for field in TABLE.fields} | given
    changes = _sensor_changes(values)
    mounts = cfg.sensor_mounts
    plain = mounts == as_mounts(tuple(mount.sensor for mount in mounts)) and len(mounts) == len(changes["sensors"])
    return replace_config_entries(cfg, changes) if plain else cfg


def _base_robot(cls: Any, given: Values) -> RobotCfg:
    """Return the robot that a class changes: that of its URDF among those of that simulator, else of its ancestor."""
    made = getattr(cls, STANDS_FOR, ROBOTS.get("base_quadrotor"))
    path = _urdf_path({_FOLDER: FOLDER, _FILE: _urdf_file(made), **given})
    name = _standard_robot(path)
    if name is None or path.is_file() or path == Path(FOLDER, _urdf_file(made)):
        return made
    driven = f"{name}_{given.get(f'{_JOINTS}.dof_mode')}"
    return ROBOTS.get(driven if driven in ROBOTS else name)


BaseQuadCfg = TABLE.make_class("BaseQuadCfg", ROBOTS.get("base_quadrotor"))

CLASSES: dict[str, type] = {"base_quadrotor": BaseQuadCfg} | {
    robot: TABLE.make_class(name, _robot_with_pushes(robot), parent=BaseQuadCfg)
    for name, robot in (
        ("BaseQuadWithImuCfg", "base_quadrotor_with_imu"), ("BaseQuadWithCameraCfg", "base_quadrotor_with_camera"),
        ("BaseQuadWithCameraImuCfg", "base_quadrotor_with_camera_imu"), ("BaseQuadWithLidarCfg", "base_quadrotor_with_lidar"),
        ("BaseQuadWithFaceIDNormalCameraCfg", "base_quadrotor_with_faceid_normal_camera"),
        ("BaseQuadWithStereoCameraCfg", "base_quadrotor_with_stereo_camera"), ("TinyPropCfg", "tinyprop"),
        ("BaseQuadRootLinkControlCfg", "base_quad_root_link_control"), ("BaseOctarotorCfg", "base_octarotor"),
        ("BaseRandCfg", "base_random"), ("BaseROVCfg", "base_rov"), ("LMF1Cfg", "lmf1"), ("LMF2Cfg", "lmf2_with_camera"),
        ("LMF2RadarCfg", "lmf2_radar"), ("MagpieCfg", "magpie"), ("X500Cfg", "x500"), ("MorphyCfg", "morphy"),
        ("MorphyFixedBaseCfg", "morphy_fixed_base"), ("MorphyStiffCfg", "morphy_stiff"), ("SnakeyCfg", "snakey"),
        ("Snakey5Cfg", "snakey5"), ("Snakey6Cfg", "snakey6"),
    )
}  # fmt: skip
"""Generated classes by the name of the robot."""

BY_CLASS_NAME: dict[str, type] = {cls.__name__: cls for cls in CLASSES.values()}
