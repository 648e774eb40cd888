"""Robots: classes with ``init_config``, ``sensor_config``, ``robot_asset`` and ``control_allocator_config`` inside.

That simulator has mass, inertia and geometry in URDF files; this package in a robot file, from which the allocation matrix
is derived. A class modifies the robot of its nearest generated ancestor; with a URDF and an allocation matrix of its own it
replaces the body. Thrust constants change from per (rev/s)² to per (rad/s)².
"""

from math import pi
from typing import Any

from aerial_gym.compat.config import bodies
from aerial_gym.compat.config.fields import (
    Changes,
    ConfigTable,
    Values,
    constant_field,
    direct_field,
    idle_field,
    lookup_field,
    replace_entries,
)
from aerial_gym.compat.config.imus import imu_class, imu_name
from aerial_gym.compat.config.sensors import sensor_class, sensor_name
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sensor import LidarCfg
from aerial_gym.config.sensor_mount import as_mounts
from aerial_gym.robots import ROBOTS
from aerial_gym.sensors import IMUS, SENSORS

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


def _rotor_mode_changes(values: Values) -> Changes:
    """Return the mode of the rotors and their thrust map, None in force mode."""
    speed = bool(values[f"{_MOTOR}.use_rps"])
    coefficient = _middle_of_range(values, "motor_thrust_constant") / _PER_TURN if speed else 0.0
    return {"rotor.mode": "speed" if speed else "force", "rotor.thrust_map": (0.0, 0.0, coefficient)}


def _slew_rate_changes(values: Values) -> Changes:
    """Return the largest rate of the state: there [rev/s²] or [N/s]."""
    rate = float(values[f"{_MOTOR}.max_thrust_rate"])
    return {"rotor.slew_rate": 2.0 * pi * rate if values[f"{_MOTOR}.use_rps"] else rate}


def _script_slew_rate(cfg: RobotCfg) -> float:
    rotor = cfg.rotor_types[0]
    if rotor.slew_rate is None:
        return _NEVER_ACTIVE
    return rotor.slew_rate / (2.0 * pi) if rotor.mode == "speed" else rotor.slew_rate


def _drag_changes(values: Values) -> Changes:
    """Return the drag effects of the damping coefficients; the same laws."""
    changes: Changes = {"effects_source": "damping of a robot class"}
    for name, order in (("rotor_drag", "linear"), ("quadratic_drag", "quadratic")):
        coefficients = values[f"damping.linvel_{order}_damping_coefficient"]
        if any(coefficients):
            changes[f"effects.{name}"] = dict(zip(("dx", "dy", "dz"), map(float, coefficients), strict=True))
    return changes


def _sensor_changes(values: Values) -> Changes:
    names = (("camera", sensor_name), ("lidar", sensor_name), ("imu", imu_name))
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


_VISUAL = "`visual:` of a robot file"
_NO_SENSOR = "no sensor of forces on links"
_START = "init_config says where a robot starts"

TABLE = ConfigTable(
    kind="robot",
    fields=(
        direct_field("init_config.min_init_state", "initial_state.*_low", lambda c: _initial_state(c, "low"),
                _initial_state_changes("low"),
                "shares of the bounds, roll, pitch, yaw, a 1, velocity, angular velocity (body axes)"),
        direct_field("init_config.max_init_state", "initial_state.*_high", lambda c: _initial_state(c, "high"),
                _initial_state_changes("high")),
        direct_field("sensor_config.enable_camera", "sensors", lambda c: _sensor_class(c, "camera", None) is not None,
                _sensor_changes, "a camera and a lidar together work here"),
        direct_field("sensor_config.camera_config", "sensors", lambda c: _sensor_class(c, "camera", "base_depth_camera"),
                     _sensor_changes),
        direct_field("sensor_config.enable_lidar", "sensors", lambda c: _sensor_class(c, "lidar", None) is not None,
                _sensor_changes),
        direct_field("sensor_config.lidar_config", "sensors", lambda c: _sensor_class(c, "lidar", "base_lidar"),
                _sensor_changes),
        direct_field("sensor_config.enable_imu", "sensors", lambda c: _imu_class(c, None) is not None, _sensor_changes),
        direct_field("sensor_config.imu_config", "sensors", lambda c: _imu_class(c, "base_imu"), _sensor_changes),
        constant_field("disturbance.enable_disturbance", False,
                "pushes per physics step would depend on dt: use the effect gusts in a robot file"),
        idle_field("disturbance.prob_apply_disturbance", 0.02, "only with enable_disturbance"),
        idle_field("disturbance.max_force_and_torque_disturbance", [0.0] * 6, "only with enable_disturbance"),
        direct_field("damping.linvel_linear_damping_coefficient", "effects.rotor_drag",
                lambda c: _drag_coefficients(c, "rotor_drag"), _drag_changes),
        direct_field("damping.linvel_quadratic_damping_coefficient", "effects.quadratic_drag",
                lambda c: _drag_coefficients(c, "quadratic_drag"), _drag_changes),
        constant_field("damping.angular_linear_damping_coefficient", [0.0] * 3,
                "there is no such effect here yet; 0 is what all robots have"),
        constant_field("damping.angular_quadratic_damping_coefficient", [0.0] * 3,
                "there is no such effect here yet; 0 is what all robots have"),
        direct_field("robot_asset.asset_folder", "body, collision", lambda _: bodies.FOLDER, bodies.body_changes,
                "a URDF: all links as one body about their centre of mass; its spheres and boxes, boxes around the rest"),
        direct_field("robot_asset.file", "body, collision", _urdf_file, bodies.body_changes),
        constant_field("robot_asset.fix_base_link", False, "robots fly here"),
        lookup_field("robot_asset.disable_gravity", "gravity: 0 of the sim", lambda _: False, "only robots feel gravity there"),
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
            ("max_position_ratio", None, _START),
        )),
        *(idle_field(f"init_config.{name}", None, "min_init_state and max_init_state say where a robot starts")
          for name in ("min_state_ratio", "max_state_ratio")),
        direct_field(bodies.MATRIX, "mounts", bodies.allocation_matrix, bodies.rotor_changes,
                "the rotors stand where the matrix has them; it is derived from them again"),
        direct_field("control_allocator_config.num_motors", "mounts", lambda c: c.num_rotors, bodies.rotor_changes),
        direct_field(bodies.DIRECTIONS, "mounts: spin", lambda c: [m.spin for m in c.mounts.layout], bodies.rotor_changes,
                "matrix and directions must say the same"),
        idle_field("control_allocator_config.application_mask", None, "thrust acts where the rotors are"),
        idle_field("control_allocator_config.force_application_level", "motor_link", "thrust acts where the rotors are"),
        direct_field(f"{_MOTOR}.use_rps", "rotor.mode", lambda c: c.rotor_types[0].mode == "speed", _rotor_mode_changes,
                "speed or force"),
        *(direct_field(f"{_MOTOR}.motor_thrust_constant_{end}", "rotor.thrust_map",
                  lambda c: c.rotor_types[0].thrust_map[2] * _PER_TURN, _rotor_mode_changes, f"N per (rev/s)²; {_RANGE}")
          for end in ("min", "max")),
        *(direct_field(f"{_MOTOR}.motor_time_constant_{way}_{end}", f"rotor.{native}",
                  lambda c, n=native: getattr(c.rotor_types[0], n),
                  lambda v, way=way, n=native: {f"rotor.{n}": _middle_of_range(v, f"motor_time_constant_{way}")}, remark)
          for way, native, remark in (
              ("increasing", "time_constant_up", f"{_RANGE}; there the lag was tau + dt"),
              ("decreasing", "time_constant_down", _RANGE),
          )
          for end in ("min", "max")),
        *(direct_field(f"{_MOTOR}.{end}_thrust", "rotor.thrust_range",
                  lambda c, place=place: c.rotor_types[0].thrust_range[place],
                  lambda v: {"rotor.thrust_range": tuple(float(v[f"{_MOTOR}.{end}_thrust"]) for end in ("min", "max"))})
          for place, end in enumerate(("min", "max"))),
        direct_field(f"{_MOTOR}.thrust_to_torque_ratio", "rotor.torque_ratio", lambda c: c.rotor_types[0].torque_ratio,
                lambda v: {"rotor.torque_ratio": float(v[f"{_MOTOR}.thrust_to_torque_ratio"]), "rotor.torque_map": None}),
        direct_field(f"{_MOTOR}.max_thrust_rate", "rotor.slew_rate", _script_slew_rate, _slew_rate_changes, "100000 is none"),
        idle_field(f"{_MOTOR}.use_discrete_approximation", True, "the lag is exact for every dt"),
        idle_field(f"{_MOTOR}.integration_scheme", "rk4", "the lag is exact for every dt"),
        lookup_field("dof_control_mode", "-", lambda _: "none", "no robot has joints yet"),
    ),
    idle_sections={"reset_asset": "-"},
)  # fmt: skip
"""Translation of the attributes of a robot class."""


def has_no_gravity(cls: Any) -> bool:
    """Return whether a robot class feels no gravity."""
    return bool(TABLE.values(cls).get("robot_asset.disable_gravity", False))


def translate_robot(cls: Any) -> RobotCfg:
    """Return our robot for a robot class; sensor classes are changed in place by scripts, so they are read at every call."""
    cfg = TABLE.translate(cls, ROBOTS.get("base_quadrotor"))
    values = {field.script_name: field.read(cfg) for field in TABLE.fields} | TABLE.values(cls)
    changes = _sensor_changes(values)
    mounts = cfg.sensor_mounts
    plain = mounts == as_mounts(tuple(mount.sensor for mount in mounts)) and len(mounts) == len(changes["sensors"])
    return replace_entries(cfg, changes) if plain else cfg


BaseQuadCfg = TABLE.make_class("BaseQuadCfg", ROBOTS.get("base_quadrotor"))

CLASSES: dict[str, type] = {"base_quadrotor": BaseQuadCfg} | {
    robot: TABLE.make_class(name, ROBOTS.get(robot), parent=BaseQuadCfg)
    for name, robot in (
        ("BaseQuadWithImuCfg", "base_quadrotor_with_imu"), ("BaseQuadWithCameraCfg", "base_quadrotor_with_camera"),
        ("BaseQuadWithCameraImuCfg", "base_quadrotor_with_camera_imu"), ("BaseQuadWithLidarCfg", "base_quadrotor_with_lidar"),
        ("BaseQuadWithFaceIDNormalCameraCfg", "base_quadrotor_with_faceid_normal_camera"),
        ("BaseQuadWithStereoCameraCfg", "base_quadrotor_with_stereo_camera"), ("TinyPropCfg", "tinyprop"),
    )
}  # fmt: skip
"""Generated classes by the name of the robot."""
