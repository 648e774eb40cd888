"""Content of the page as plain numbers on the host: the fixed part of a scene, and its state at one instant.

Frames: world z up, body x forward, y left, z up; quaternions are xyzw. Both parts can be sent to another process.
Letters: E environments, N vehicles, R rotors, L links, P parts of obstacles, S sensors of one kind, H x W pixels.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from aerial_gym.config.images import IMAGES
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sensor import RangeSensorCfg
from aerial_gym.config.shape import PartCfg
from aerial_gym.math.quaternion import quat_multiply, quat_rotate
from aerial_gym.task.commands.command import TARGET

if TYPE_CHECKING:
    from aerial_gym.env_manager import EnvManager

Array = NDArray[np.float32]
Rgb = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class SceneContent:
    """The part of a scene that stays the same during a simulation."""

    robot: RobotCfg  # Vehicle of every environment
    num_envs: int  # Environments E
    dt: float  # Time of an environment step [s]
    parts: tuple[PartCfg, ...]  # Rows of the shape table that obstacles use
    colors: tuple[tuple[float, float, float] | None, ...]  # Colours that these inherit
    ground_height: float | None  # [m], world; None without ground
    sensors: dict[str, RangeSensorCfg]  # Range sensors on board, by name


@dataclass(frozen=True, kw_only=True)
class SensorSample:
    """Images of one kind of sensor and where its sensors are."""

    position: Array  # [m], world, (S, 3)
    attitude: Array  # Sensor to world, (S, 4)
    distance: Array  # (S, H, W)
    color: Array | None = None  # Red, green, blue in 0 to 1, (S, H, W, 3)


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """The part of a scene that changes: vehicles, and the surroundings of one environment."""

    env: int  # Number of the environment
    time: float  # Since its episode began [s]
    episode: int  # Number of its episode
    chosen: int  # Which of the vehicles is that of the environment
    position: Array  # Vehicles [m], world, (N, 3)
    attitude: Array  # Body to world, (N, 4)
    velocity: Array  # Of the environment's vehicle [m/s], world, (3,)
    rotor_state: Array  # Rotor speeds [rad/s], in force mode thrusts [N], (N, R)
    links: Array | None  # Position and xyzw of the links, world, (N, L, 7); None of a rigid vehicle
    bounds: Array  # Lower and upper corner of the room [m], world, (2, 3)
    part_row: NDArray[np.int32]  # Row of each part of an obstacle in ``SceneContent.parts``, -1 for none, (P,)
    part_place: Array  # Position [m] and xyzw of its obstacle, world, (P, 7)
    goal: Array | None = None  # Where to fly [m], world, (3,)
    gate: Array | None = None  # Attitude of the next gate, whose centre is the goal, (4,)
    readings: dict[str, SensorSample] = field(default_factory=dict)  # By name of the sensor
    forces: dict[str, Array] = field(default_factory=dict)  # Of each effect on its vehicle [N], world, (3,)


class SnapshotReader:
    """Reads snapshots from the Global Tensor Dictionary; it writes nothing and launches nothing in a step."""

    def __init__(self, env: "EnvManager", values: Mapping[str, Tensor]) -> None:
        """Take a simulation and the buffers of its task, of which it shows the goal and the gate."""
        self._env, self._gtd, self._values = env, env.gtd, values
        scene, robot = env.asset_manager.scene, env.robot_manager.cfg
        shapes = scene.shape_table.shapes
        parts, self._part_row, self._part_instance = scene.instance_parts()
        colors = [shape.color for shape in shapes for _ in shape.parts or (shape,)]
        casters = env.sensor_manager.casters
        self.content = SceneContent(
            robot=robot, num_envs=env.num_envs, dt=env.dt, parts=parts, colors=tuple(colors[: len(parts)]),
            ground_height=env.cfg.ground_height, sensors={name: caster.cfg for name, caster in casters.items()},
        )  # fmt: skip
        self._links = None if robot.joints is None else self._gtd.plain("robot_link_state_tensor")
        self._carriers = [robot.link_names.index(mount.parent) if robot.joints and mount.parent != "body" else 0
                          for mount in robot.sensor_mounts if mount.key in casters]  # fmt: skip

    @torch.no_grad()
    def read(self, env: int, *, alone: bool = False, forces: Mapping[str, Array] | None = None) -> Snapshot:
        """Return the present state around one environment; waits for the device.

        Args:
            env: Number of the environment.
            alone: Whether to read its vehicle alone, which costs less.
            forces: Force of each effect on its vehicle [N], world, (3,).
        """
        rows = slice(env, env + 1) if alone else slice(None)
        target, gate = (self._values.get(name) for name in (TARGET, "target_orientation"))
        count = self._part_row.shape[1]
        instance = self._part_instance[env].long()
        places = self._gtd.plain("vec_root_tensor")[env, 1:, :7]
        return Snapshot(
            env=env, time=float(self._gtd.plain("sim_steps")[env]) * self._env.dt,
            episode=int(self._gtd.plain("episodes")[env]), chosen=0 if alone else env,
            position=self._array("robot_position", rows), attitude=self._array("robot_orientation", rows),
            velocity=self._array("robot_linvel", env), rotor_state=self._array("rotor_speed", rows),
            links=None if self._links is None else to_array(self._links[rows, :, :7]),
            bounds=np.stack([self._array(f"env_bounds_{end}", env) for end in ("min", "max")]),
            part_row=self._part_row[env].cpu().numpy(),
            part_place=to_array(places[instance]) if count else np.zeros((0, 7), dtype=np.float32),
            goal=None if target is None else to_array(target[env]),
            gate=None if gate is None else to_array(gate[env]),
            readings={name: self._read_sensor(env, name, number) for number, name in enumerate(self.content.sensors)},
            forces=dict(forces or {}),
        )  # fmt: skip

    def _array(self, key: str, rows: int | slice) -> Array:
        return to_array(self._gtd.plain(key)[rows])

    def _read_sensor(self, env: int, name: str, number: int) -> SensorSample:
        caster, link = self._env.sensor_manager.casters[name], self._carriers[number]
        if self._links is not None:
            origin, turn = self._links[env, link, :7].split((3, 4))
        else:
            origin, turn = (self._gtd.plain(key)[env] for key in ("robot_position", "robot_orientation"))
        mounts, turns = caster.places.position[env], caster.places.attitude[env]
        turn = turn.expand_as(turns)
        prefix = "" if number == 0 else f"{name}_"
        color = f"{prefix}{IMAGES['color'].key}"
        return SensorSample(
            position=to_array(origin + quat_rotate(turn, mounts)), attitude=to_array(quat_multiply(turn, turns)),
            distance=self._array(f"{prefix}{IMAGES['distance'].key}", env),
            color=self._array(color, env) if color in self._gtd else None,
        )  # fmt: skip


def to_array(rows: Tensor) -> Array:
    """Return a copy on the host."""
    return rows.detach().to("cpu", torch.float32, copy=True).numpy()
