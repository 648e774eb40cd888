"""Recordings of simulated flights for Foxglove and Lichtblick: vehicles, obstacles, sensors, states and commands.

Frames: ``world`` holds the world of each environment, ``env_0``, ``env_1``, ..., side by side; each holds its robot's links.
"""

from collections.abc import Iterator
from math import ceil, inf, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from aerial_gym.cli.film import sensor_images
from aerial_gym.cli.play import COLUMNS
from aerial_gym.sim2real.logs import foxglove as fox
from aerial_gym.task.chase_view import ground_part, link_states, visible_parts

if TYPE_CHECKING:
    from aerial_gym.task import Task

LIBRARY = "play of aerial_gym"  # Writer of the file; the reader of converted logs knows another
OBSTACLES_HZ = 10.0  # Largest rate at which moving obstacles are written [Hz]
GAP_M = 2.0  # Distance between the bounds of neighbouring environments [m]
ABSENT_M = -500.0  # Obstacles below are absent [m]
STILL = ((0.0, 0.0, 0.0), fox.IDENTITY)


class FlightRecorder:
    """Writes all environments of a task, step by step, with the sensors of the first one."""

    def __init__(self, task: "Task", file: Path) -> None:
        """Create the file."""
        from aerial_gym.task.commands.command import TARGET

        env = self._env = task.env
        self._file, self._step, self._robot = fox.McapFile(file, LIBRARY), 0, env.robot_manager.cfg
        self._target = task.target_position if TARGET in task.values else None
        self._shown: dict[int, Tensor] = {}  # Obstacle states in the file, (A, 13) each
        bounds = zip(env.cfg.bounds_lower_low, env.cfg.bounds_upper_high, strict=True)
        pitch, columns = GAP_M + max(high - low for low, high in bounds), ceil(sqrt(env.num_envs))
        self._origins = [(e % columns * pitch, e // columns * pitch, 0.0) for e in range(env.num_envs)]
        self.close = self._file.close

    def write_step(self, _begins: Tensor) -> None:
        """Append the present state of all environments."""
        for message in self._messages(round(self._step * self._env.dt * fox.SECOND)):
            self._file.write(message)
        self._step += 1

    def _messages(self, time: int) -> Iterator[fox.McapMessage]:
        yield fox.transforms_message(time, list(self._frames(time)))
        for env in range(self._env.num_envs):
            if self._step == 0:
                parts = visible_parts(self._robot)
                links = {
                    link: [(part, *STILL) for part in parts if part.link == link] for link in self._robot.link_names
                }
                shapes = {f"env_{env}/{link}": fox.part_primitives(placed) for link, placed in links.items()}
                yield fox.scene_message(time, f"/env_{env}/vehicle", shapes)
            yield from self._obstacles(time, env)
            yield from self._numbers(time, env)
        yield from self._sensors(time)

    def _frames(self, time: int) -> Iterator[fox.Json]:
        states = link_states(self._env)[..., :7].tolist()
        for env, (origin, links) in enumerate(zip(self._origins, states, strict=True)):
            yield fox.transform(time, fox.WORLD, f"env_{env}", origin, fox.IDENTITY)
            for name, state in zip(self._robot.link_names, links, strict=True):
                yield fox.transform(time, f"env_{env}", f"env_{env}/{name}", state[:3], state[3:])
        mounts = {mount.key: mount.link for mount in self._robot.sensor_mounts}
        for name, caster in self._env.sensor_manager.casters.items():
            place, turn = caster.places.position[0, 0].tolist(), caster.places.attitude[0, 0].tolist()
            yield fox.transform(time, f"env_0/{mounts[name]}", f"env_0/{name}", place, turn)
            yield fox.transform(time, f"env_0/{name}", f"env_0/{name}_image", STILL[0], fox.OPTICAL)

    def _obstacles(self, time: int, env: int) -> Iterator[fox.McapMessage]:
        """Yield ground and obstacles if they are elsewhere than in the file."""
        scene, every = self._env.asset_manager.scene, max(1, round(1.0 / (OBSTACLES_HZ * self._env.dt)))
        now = scene.asset_state[env]
        if env in self._shown and (self._step % every or torch.equal(now, self._shown[env])):
            return
        self._shown[env] = now.clone()
        table, rows, owners = scene.instance_parts()
        placed = [(ground_part(self._env), *STILL)]
        for row, owner in zip(rows[env].tolist(), owners[env].tolist(), strict=True):
            state = now[owner].tolist() if row >= 0 else [-inf] * 7
            placed += [(table[row], state[:3], state[3:7])] if state[2] > ABSENT_M else []
        yield fox.scene_message(time, f"/env_{env}/scene", {f"env_{env}": fox.part_primitives(placed)})

    def _numbers(self, time: int, env: int) -> Iterator[fox.McapMessage]:
        gtd, name = self._env.gtd, f"/env_{env}"
        keys = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel")
        state = dict(zip(COLUMNS[2:], torch.cat([gtd[key][env] for key in keys]).tolist(), strict=True))
        state |= {f"rotor_{number}": value for number, value in enumerate(gtd["rotor_speed"][env].tolist(), 1)}
        flown = fox.pose(*(gtd[key][env].tolist() for key in keys[:2]))
        yield fox.frame_message(time, f"{name}/pose", "PoseInFrame", name[1:], pose=flown)
        yield fox.number_message(time, f"{name}/state", state)
        actions = zip(self._env.robot_manager.action_names, gtd["robot_actions"][env].tolist(), strict=True)
        command = {f"action_{label}": value for label, value in actions}
        if self._target is not None:
            goal = self._target[env].tolist()
            command |= dict(zip(("sp_p_x", "sp_p_y", "sp_p_z"), goal, strict=True))
            yield fox.frame_message(time, f"{name}/goal", "PoseInFrame", name[1:], pose=fox.pose(goal))
        yield fox.number_message(time, f"{name}/command", command)

    def _sensors(self, time: int) -> Iterator[fox.McapMessage]:
        """Yield new images of the first environment, and the points of sensors without an image plane."""
        from aerial_gym.cli.render_gallery import id_colors, png_bytes

        for name, (cfg, images) in sensor_images(self._env).items():
            caster, frame = self._env.sensor_manager.casters[name], f"env_0/{name}"
            if not caster.due[0]:
                continue
            pictures = {kind: images[kind][0, 0].cpu().numpy() for kind in images}
            distance = pictures["distance"] * (cfg.max_range if cfg.normalize else 1.0)
            distance[(distance < cfg.min_range) | (distance >= cfg.max_range)] = np.nan
            yield fox.depth_message(time, f"/{frame}/{cfg.kind}", f"{frame}_image", distance)
            for kind, colors in (("segmentation", id_colors), ("color", np.asarray)):
                if kind in pictures:
                    png = {"data": png_bytes(colors(pictures[kind])), "format": "png"}
                    yield fox.frame_message(time, f"/{frame}/{kind}", "CompressedImage", f"{frame}_image", **png)
            if not cfg.has_image_plane and caster.direction.shape[:2] == distance.shape:
                points = (distance[..., None] * caster.direction.cpu().numpy())[np.isfinite(distance)]
                yield fox.points_message(time, f"/{frame}/points", frame, points)
