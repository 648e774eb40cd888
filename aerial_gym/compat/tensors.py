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


def _same_keys(*names: str, remark: str = "") -> dict[str, TensorKey]:
    """Return keys of the same name in the GTD."""
    return dict.fromkeys(names, TensorKey(native="the same", remark=remark))


def _absent_keys(*names: str, remark: str) -> dict[str, TensorKey]:
    """Return keys without counterpart; the remark is the remedy."""
    return dict.fromkeys(names, TensorKey(native="-", remark=remark))


def _key_of_joined_rows(key: str, columns: int, remark: str) -> TensorKey:
    """Return a key with the rows of all environments below one another, (rows, columns)."""
    native = f'gtd["{key}"].view(-1, {columns})'
    return TensorKey(native=native, remark=remark, read=lambda env: env.gtd[key].view(-1, columns))


def _first_present_image(*names: str) -> Read:
    """Return the function that reads the first key of the GTD that is there; the last one raises if it is missing."""
    return lambda env: env.gtd[next((name for name in names if name in env.gtd), names[-1])]


def _rgba_image(env: EnvManager) -> Tensor:
    colours = env.gtd["rgb_pixels"]
    return torch.cat((colours, torch.ones_like(colours[..., :1])), dim=-1)


def _mode_of_first_drive(env: EnvManager) -> str:
    articulation = env.robot_manager.articulation
    return articulation.modes[0] if articulation is not None and articulation.modes else "none"


_FORCES = "forces are not stored: the fused step keeps them in registers. An effect adds one (docs: effects)"
_COPY = "write_to_sim() takes what a script writes there"

KEYS: dict[str, TensorKey] = {
    **_same_keys("vec_root_tensor", remark=f"rows of the robot are copies; {_COPY}"),
    "unfolded_env_asset_state_tensor": _key_of_joined_rows("vec_root_tensor", 13, "a view of vec_root_tensor"),
    **_absent_keys(
        "unfolded_env_asset_state_tensor_const", remark="clone vec_root_tensor after the first reset"
    ),
    "rigid_body_state_tensor": _key_of_joined_rows("vec_root_tensor", 13, "robot and obstacles are one body each"),
    **_same_keys("robot_state_tensor", remark=f"a copy; {_COPY}"),
    **_same_keys("env_asset_state_tensor", "robot_position", "robot_orientation", "robot_linvel", "robot_angvel"),
    **_same_keys(
        "robot_body_linvel", "robot_body_angvel", "robot_vehicle_orientation", "robot_vehicle_linvel", "robot_euler_angles",
        remark="of the same instant as the pose; there one physics step older",
    ),
    **_absent_keys(
        "robot_force_tensor", "robot_torque_tensor", "global_force_tensor", "global_torque_tensor", remark=_FORCES
    ),
    **_absent_keys(
        "obstacle_force_tensor", "obstacle_torque_tensor",
        remark="never written there; obstacles move by twists, step(actions, env_actions)",
    ),
    **_absent_keys(
        "global_contact_force_tensor", remark="contact of the robot alone is measured: robot_contact_force_tensor"
    ),
    "robot_contact_force_tensor": TensorKey(
        native='gtd["robot_contact_force"]', read=lambda env: env.gtd["robot_contact_force"],
        remark="mean over the step; only in an environment with `contact:` in its file",
    ),
    **_same_keys("obstacle_position", "obstacle_orientation", "obstacle_linvel", "obstacle_angvel"),
    **_absent_keys("obstacle_body_linvel", remark="never filled there; rotate obstacle_linvel by obstacle_orientation"),
    **_absent_keys("obstacle_body_angvel", remark="never filled there; rotate obstacle_angvel by obstacle_orientation"),
    **_absent_keys("obstacle_euler_angles", remark="never filled there; get_euler_xyz_tensor(obstacle_orientation)"),
    **_same_keys("dof_state_tensor", remark="a copy of dof_position and dof_velocity; only of robots with joints"),
    "unfolded_dof_state_tensor": _key_of_joined_rows("dof_state_tensor", 2, "only of robots with joints"),
    **_absent_keys(
        "dof_position_setpoint_tensor", "dof_velocity_setpoint_tensor", "dof_effort_tensor",
        remark="commands of drives are the last entries of the action, in the mode that the robot file gives each",
    ),
    "dof_control_mode": TensorKey(
        native="robot_manager.articulation.modes", read=_mode_of_first_drive,
        remark="that of the first drive; each has its own",
    ),
    **_same_keys("env_bounds_min", "env_bounds_max"),
    **_absent_keys(
        "asset_min_state_ratio", remark="ranges stand in the environment file: position_ratio_low, euler_low of an asset"
    ),
    **_absent_keys(
        "asset_max_state_ratio", remark="ranges stand in the environment file: position_ratio_high, euler_high of an asset"
    ),
    "num_obstacles_in_env": TensorKey(
        native="asset_manager.set_num_obstacles(n - num_kept)",
        remark="an int that counts the kept obstacles too; assigned, it holds from the next reset on",
        read=lambda env: env.cfg.num_kept + int(env.gtd["num_obstacles_in_env"]),
    ),
    **_same_keys(
        "curriculum_level",
        remark="of a task of ours with a curriculum; a script may keep its own number under this key",
    ),
    "gravity": TensorKey(
        native="sim_cfg.gravity", remark="(E, 3), world",
        read=lambda env: torch.tensor([0.0, 0.0, -env.sim_cfg.gravity], device=env.device).expand(env.num_envs, 3),
    ),
    "dt": TensorKey(native="sim_cfg.dt", remark="of a physics step, as there", read=lambda env: env.sim_cfg.dt),
    **_same_keys("robot_mass", remark="of each environment, also where it is randomised; read-only"),
    **_same_keys(
        "robot_inertia", remark="of each environment; the composite one, there it was doubled; read-only"
    ),
    **_same_keys("robot_actions"),
    **_same_keys(
        "robot_prev_actions",
        remark="shifted once a step, where there every physics step made it equal to robot_actions",
    ),
    "num_robot_actions": TensorKey(native="robot_manager.num_actions", read=lambda env: env.robot_manager.num_actions),
    "num_env_actions": TensorKey(native="6 where obstacles move, else 0", read=lambda env: 6 if env.cfg.moves else 0),
    **_same_keys("env_actions", remark="only where obstacles move"),
    **_same_keys(
        "prev_env_actions",
        remark="only where obstacles move; those before, where there it was the same tensor",
    ),
    **_same_keys("crashes", "truncations", remark="kept over a reset until the next step, as there"),
    "depth_range_pixels": TensorKey(
        native="the same", read=_first_present_image("normal_pixels", "point_cloud_pixels", "depth_range_pixels"),
        remark="normals of a normal_faceID sensor, points with return_pointcloud, as there; gtd has distances too",
    ),
    "segmentation_pixels": TensorKey(
        native="the same", read=_first_present_image("face_id_pixels", "segmentation_pixels"),
        remark="faces of a normal_faceID sensor, as there",
    ),
    "rgb_pixels": TensorKey(
        native="the same, (..., 3)", read=_rgba_image,
        remark="with a fourth channel of 1; from the ray caster",
    ),
    **_absent_keys(
        "force_sensor_tensor",
        remark="imu_measurement has the specific force; robot_contact_force_tensor the contact",
    ),
    **_same_keys("imu_measurement", remark="with lever arm; mean over the step"),
    **_absent_keys(
        "CONST_WARP_MESH_ID_LIST", "CONST_WARP_MESH_PER_ENV", "CONST_GLOBAL_VERTEX_TO_ASSET_INDEX_TENSOR",
        "VERTEX_MAPS_PER_ENV_ORIGINAL",
        remark="shapes are shared and moved by transforms: there is no mesh per environment",
    ),
}  # fmt: skip
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
            hint = suggest_name(name, self) if key is None else f" {key.remark}." if key.remark else ""
            known = ", ".join(sorted(self))
            raise UnknownNameError(f"no tensor key {name!r} in this simulation.{hint} Known: {known}") from None

    def __setitem__(self, name: str, value: Any) -> None:
        if name == "num_obstacles_in_env":
            self._env.asset_manager.set_num_obstacles(max(int(value) - self._env.cfg.num_kept, 0))
            return
        key = KEYS.get(name)
        if name in self._env.gtd and (key is None or key.read is None):
            self._env.gtd[name][:] = value
        elif key is not None and key.read is not None:
            home = f"tensor key {name!r} = {key.native} here"
            raise OwnershipError(f"{home}: it follows from other keys and cannot be assigned")
        else:
            self._own[name] = value

    def __delitem__(self, name: str) -> None:
        if name not in self._own:
            raise OwnershipError(f"tensor key {name!r}: only keys that the script has added can be deleted")
        del self._own[name]

    def __iter__(self) -> Iterator[str]:
        yield from dict.fromkeys((*self._env.gtd, *(name for name in KEYS if self._is_present(name)), *self._own))

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _is_present(self, name: str) -> bool:
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
