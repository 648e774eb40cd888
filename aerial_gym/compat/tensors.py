"""The tensor dictionary of the Aerial Gym Simulator as a view of the Global Tensor Dictionary.

Keys with equal name and shape are the GTD's tensors; others are computed when read. An assigned value is copied into the
simulation's tensor; that simulator only replaced the reference. Letters: E environments, A obstacles.
"""

from collections.abc import Callable, Iterator, MutableMapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from aerial_gym.env_manager import EnvManager
from aerial_gym.errors import OwnershipError, UnknownNameError, suggest_name

Read = Callable[[EnvManager], Any]


@dataclass(frozen=True, kw_only=True)
class TensorKey:
    """A key of that simulator."""

    native: str  # Counterpart for the documentation; `-` for none
    remark: str = ""  # Difference, or remedy
    read: Read | None = None  # Its value; None without one


def _own(remark: str = "", key: str | None = None) -> TensorKey:
    """Return a key with a counterpart in the GTD, of another name if given."""
    return TensorKey(
        native=f'gtd["{key}"]' if key else "the same", remark=remark, read=(lambda env: env.gtd[key]) if key else None
    )


def _absent_key(way_out: str) -> TensorKey:
    return TensorKey(native="-", remark=way_out)


def _gravity(env: EnvManager) -> Tensor:
    return torch.tensor([0.0, 0.0, -env.sim_cfg.gravity], device=env.device).expand(env.num_envs, 3)


def _distances(env: EnvManager) -> Tensor:
    """Return the first sensor's image that this key holds in that simulator: normals, points or distances."""
    for key in ("normal_pixels", "point_cloud_pixels"):
        if key in env.gtd:
            return env.gtd[key]
    return env.gtd["depth_range_pixels"]


def _segmentation(env: EnvManager) -> Tensor:
    return env.gtd["face_id_pixels" if "face_id_pixels" in env.gtd else "segmentation_pixels"]


def _colours(env: EnvManager) -> Tensor:
    colours = env.gtd["rgb_pixels"]
    return torch.cat((colours, torch.ones_like(colours[..., :1])), dim=-1)


def _drive_mode(env: EnvManager) -> str:
    bends = env.robot_manager.articulation
    return bends.modes[0] if bends is not None and bends.modes else "none"


_FLAT = "a view of vec_root_tensor"
_DRIVES = "commands of drives are the last entries of the action, in the mode that the robot file gives each"
_FORCES = "forces are not stored: the fused step keeps them in registers. An effect adds one (docs: effects)"
_MESHES = "shapes are shared and moved by transforms: there is no mesh per environment"

KEYS: dict[str, TensorKey] = {
    "vec_root_tensor": _own("rows of the robot are copies; write_to_sim() takes what a script writes there"),
    "unfolded_env_asset_state_tensor": TensorKey(
        native='gtd["vec_root_tensor"].view(-1, 13)',
        remark=_FLAT,
        read=lambda env: env.gtd["vec_root_tensor"].view(-1, 13),
    ),
    "unfolded_env_asset_state_tensor_const": _absent_key("clone vec_root_tensor after the first reset"),
    "rigid_body_state_tensor": TensorKey(
        native='gtd["vec_root_tensor"].view(-1, 13)',
        remark="robot and obstacles are one body each",
        read=lambda env: env.gtd["vec_root_tensor"].view(-1, 13),
    ),
    "robot_state_tensor": _own("a copy; write_to_sim() takes what a script writes there"),
    "env_asset_state_tensor": _own(),
    "robot_position": _own(),
    "robot_orientation": _own(),
    "robot_linvel": _own(),
    "robot_angvel": _own(),
    "robot_body_linvel": _own("of the same instant as the pose; there one physics step older"),
    "robot_body_angvel": _own("of the same instant as the pose; there one physics step older"),
    "robot_vehicle_orientation": _own("of the same instant as the pose; there one physics step older"),
    "robot_vehicle_linvel": _own("of the same instant as the pose; there one physics step older"),
    "robot_euler_angles": _own("of the same instant as the pose; there one physics step older"),
    "robot_force_tensor": _absent_key(_FORCES),
    "robot_torque_tensor": _absent_key(_FORCES),
    "global_force_tensor": _absent_key(_FORCES),
    "global_torque_tensor": _absent_key(_FORCES),
    "obstacle_force_tensor": _absent_key("never written there; obstacles move by twists, step(actions, env_actions)"),
    "obstacle_torque_tensor": _absent_key("never written there; obstacles move by twists, step(actions, env_actions)"),
    "global_contact_force_tensor": _absent_key("contact of the robot alone is measured: robot_contact_force_tensor"),
    "robot_contact_force_tensor": _own(
        "mean over the step; only in an environment with `contact:` in its file", "robot_contact_force"
    ),
    "obstacle_position": _own(),
    "obstacle_orientation": _own(),
    "obstacle_linvel": _own(),
    "obstacle_angvel": _own(),
    "obstacle_body_linvel": _absent_key("never filled there; rotate obstacle_linvel by obstacle_orientation"),
    "obstacle_body_angvel": _absent_key("never filled there; rotate obstacle_angvel by obstacle_orientation"),
    "obstacle_euler_angles": _absent_key("never filled there; get_euler_xyz_tensor(obstacle_orientation)"),
    "dof_state_tensor": _own("a copy of dof_position and dof_velocity; only of robots with joints"),
    "unfolded_dof_state_tensor": TensorKey(
        native='gtd["dof_state_tensor"].view(-1, 2)',
        remark="only of robots with joints",
        read=lambda env: env.gtd["dof_state_tensor"].view(-1, 2),
    ),
    "dof_position_setpoint_tensor": _absent_key(_DRIVES),
    "dof_velocity_setpoint_tensor": _absent_key(_DRIVES),
    "dof_effort_tensor": _absent_key(_DRIVES),
    "dof_control_mode": TensorKey(
        native="robot_manager.articulation.modes", remark="that of the first drive; each has its own", read=_drive_mode
    ),
    "env_bounds_min": _own(),
    "env_bounds_max": _own(),
    "asset_min_state_ratio": _absent_key(
        "ranges stand in the environment file: position_ratio_low, euler_low of an asset"
    ),
    "asset_max_state_ratio": _absent_key(
        "ranges stand in the environment file: position_ratio_high, euler_high of an asset"
    ),
    "num_obstacles_in_env": TensorKey(
        native="asset_manager.set_num_obstacles(n - num_kept)",
        remark="an int that counts the kept obstacles too; assigned, it holds from the next reset on",
        read=lambda env: env.cfg.num_kept + int(env.gtd["num_obstacles_in_env"]),
    ),
    "curriculum_level": _own("of a task of ours with a curriculum; a script may keep its own number under this key"),
    "gravity": TensorKey(native="sim_cfg.gravity", remark="(E, 3), world", read=_gravity),
    "dt": TensorKey(native="sim_cfg.dt", remark="of a physics step, as there", read=lambda env: env.sim_cfg.dt),
    "robot_mass": _own("of each environment, also where it is randomised; read-only"),
    "robot_inertia": _own("of each environment; the composite one, where there it was doubled; read-only"),
    "robot_actions": _own(),
    "robot_prev_actions": _own("shifted once a step, where there every physics step made it equal to robot_actions"),
    "num_robot_actions": TensorKey(native="robot_manager.num_actions", read=lambda env: env.robot_manager.num_actions),
    "num_env_actions": TensorKey(native="6 where obstacles move, else 0", read=lambda env: 6 if env.cfg.moves else 0),
    "env_actions": _own("only where obstacles move"),
    "prev_env_actions": _own("only where obstacles move; those before, where there it was the same tensor"),
    "crashes": _own("kept over a reset until the next step, as there"),
    "truncations": _own("kept over a reset until the next step, as there"),
    "depth_range_pixels": TensorKey(
        native="the same",
        remark="normals of a normal_faceID sensor, points with return_pointcloud, as there; gtd has distances too",
        read=_distances,
    ),
    "segmentation_pixels": TensorKey(
        native="the same", remark="faces of a normal_faceID sensor, as there", read=_segmentation
    ),
    "rgb_pixels": TensorKey(
        native="the same, (..., 3)", remark="with a fourth channel of 1; from the ray caster", read=_colours
    ),
    "force_sensor_tensor": _absent_key(
        "imu_measurement has the specific force; robot_contact_force_tensor the contact"
    ),
    "imu_measurement": _own("with lever arm; mean over the step"),
    "CONST_WARP_MESH_ID_LIST": _absent_key(_MESHES),
    "CONST_WARP_MESH_PER_ENV": _absent_key(_MESHES),
    "CONST_GLOBAL_VERTEX_TO_ASSET_INDEX_TENSOR": _absent_key(_MESHES),
    "VERTEX_MAPS_PER_ENV_ORIGINAL": _absent_key(_MESHES),
}
"""Every key of that simulator with its counterpart."""


class TensorDict(MutableMapping[str, Any]):
    """Replacement of ``global_tensor_dict``: keys of that simulator, of this package and of the script."""

    def __init__(self, env: EnvManager) -> None:
        self._env = env
        self._own: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name in self._own:
            return self._own[name]
        key = KEYS.get(name)
        if key is not None and key.native == "-":
            raise UnknownNameError(f"tensor key {name!r}: has no counterpart here: {key.remark}")
        try:
            return self._env.gtd[name] if key is None or key.read is None else key.read(self._env)
        except UnknownNameError:
            remark = "" if key is None or not key.remark else f" {key.remark}."
            near = "" if key else suggest_name(name, self)
            raise UnknownNameError(
                f"no tensor key {name!r} in this simulation.{near}{remark} Known: {', '.join(sorted(self))}"
            ) from None

    def __setitem__(self, name: str, value: Any) -> None:
        if name == "num_obstacles_in_env":
            self._env.asset_manager.set_num_obstacles(max(int(value) - self._env.cfg.num_kept, 0))
            return
        key = KEYS.get(name)
        if name in self._env.gtd and (key is None or key.read is None):
            self._env.gtd[name][:] = value
        elif key is not None and key.read is not None:
            raise OwnershipError(
                f"tensor key {name!r} = {key.native} here: it follows from other keys and cannot be assigned"
            )
        else:
            self._own[name] = value

    def __delitem__(self, name: str) -> None:
        if name not in self._own:
            raise OwnershipError(f"tensor key {name!r}: only keys that the script has added can be deleted")
        del self._own[name]

    def __iter__(self) -> Iterator[str]:
        yield from dict.fromkeys((*self._env.gtd, *(name for name in KEYS if self._is_there(name)), *self._own))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _is_there(self, name: str) -> bool:
        key = KEYS[name]
        if key.read is None:
            return name in self._env.gtd
        try:
            key.read(self._env)
        except UnknownNameError:
            return False
        return True

    def __str__(self) -> str:
        return str(self._env.gtd)
