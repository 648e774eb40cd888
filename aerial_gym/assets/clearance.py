"""Clearance around the robots' starts and goals: obstacles within it are redrawn, and parked if that fails.

An instance is redrawn until it is far enough from every clear point of the episode, at most ``NUM_ATTEMPTS`` times, and
parked if no draw is. So the distance always holds with a bounded amount of work, and each instance is decided alone. Assets
with a fixed place (walls, rooms) stay.
Frames: world of each environment, z up. Letters: E environments, A instances, V robots of an environment.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.geometry import signed_distance
from aerial_gym.assets.obstacles import Obstacles, draw_instance, park_instance
from aerial_gym.assets.scene import PARKED_Z, Scene
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, SceneArrays, part_attitude, part_position
from aerial_gym.interop import ReusableLaunch
from aerial_gym.math.random import copy_mask

NUM_ATTEMPTS = 16  # Largest number of redraws of an instance. If half of its range is blocked, 1 in 65,000 is parked
START, GOAL = 0, 1  # Indices of the points that are kept clear


@wp.func
def least_gap(scene: SceneArrays, env: int, first: int, end: int, point: wp.vec3, limit: float) -> float:
    """Return the least distance of parts ``first`` to ``end`` from a point [m], at most ``limit``."""
    nearest = float(limit)
    for part in range(first, end):
        offset = point - part_position(scene, env, part)
        if wp.length(offset) - scene.radius[env, part] < nearest:
            local = wp.quat_rotate_inv(part_attitude(scene, env, part), offset)
            nearest = wp.min(nearest, signed_distance(scene.shapes[scene.part_shape[env, part]], local))
    return nearest


@wp.func
def _least_gap_of_points(
    scene: SceneArrays, env: int, first: int, end: int, start: wp.array2d[wp.vec3], point: wp.array2d[wp.vec3],
    point_index: int, room: float,
) -> float:  # fmt: skip
    """Return the least distance of parts ``first`` to ``end`` from the starts, and from the goals with ``GOAL`` [m]."""
    nearest = float(room)
    for v in range(point.shape[1]):
        if point_index > 0:
            nearest = least_gap(scene, env, first, end, start[env, v], nearest)
    for v in range(point.shape[1]):
        nearest = least_gap(scene, env, first, end, point[env, v], nearest)
    return nearest


@wp.kernel(enable_backward=False)
def _redraw_or_park(
    mask: wp.array[wp.bool],  # (E,)
    # scene
    scene: SceneArrays,
    first_part: wp.array2d[wp.int32],  # (E, A)
    end_part: wp.array2d[wp.int32],  # (E, A)
    # params
    point: wp.array2d[wp.vec3],  # (E, V) starts or goals, world [m]
    point_index: int,  # START or GOAL
    room: float,  # [m]
    num_attempts: int,
    parked_z: float,  # [m]
    # out
    start_out: wp.array2d[wp.vec3],  # (E, V) world [m]; written with START, read with GOAL
    obstacles_out: Obstacles,
):
    """Redraw, or park, the instances that are too close; leave all others and other environments alone."""
    env, a = wp.tid()
    if not mask[env]:
        return
    if point_index == 0 and a == 0:
        for v in range(point.shape[1]):
            start_out[env, v] = point[env, v]
    if obstacles_out.table[obstacles_out.asset[env, a]].is_drawn == 0:
        return
    if obstacles_out.position[env, a][2] < ABSENT_BELOW:
        return
    first = first_part[env, a]
    end = end_part[env, a]
    gap = _least_gap_of_points(scene, env, first, end, start_out, point, point_index, room)
    attempt = num_attempts * point_index  # start and goal have draws of their own
    last_attempt = attempt + num_attempts
    while gap < room and attempt < last_attempt:
        attempt += 1
        draw_instance(obstacles_out, env, a, attempt)
        gap = _least_gap_of_points(scene, env, first, end, start_out, point, point_index, room)
    if gap < room:
        park_instance(obstacles_out, env, a, parked_z)


class Clearance:
    """Clear space around starts and goals of the robots; all views are made at construction."""

    def __init__(self, scene: Scene, obstacles: Obstacles, *, mask: Tensor, room: float, num_robots: int = 1) -> None:
        """Record the launches for start and goal, with the least distance ``room`` [m] to the surface of an instance."""
        envs, device = scene.num_envs, scene.device
        self._mask = mask
        self._point, self._start = (torch.zeros(envs, num_robots, 3, device=device) for _ in range(2))
        self._scene = scene
        self.first_part, self.end_part = (torch.zeros_like(scene.shape_index) for _ in range(2))
        self.update_part_ranges()
        inputs = [self._mask, scene.arrays, self.first_part, self.end_part, self._point]
        self._commands = [
            ReusableLaunch(
                _redraw_or_park,
                dim=obstacles.asset.shape,
                inputs=[*inputs, point_index, room, NUM_ATTEMPTS, PARKED_Z],
                outputs=[self._start, obstacles],
                device=device,
            )
            for point_index in (START, GOAL)
        ]

    def update_part_ranges(self) -> None:
        """Update the shapes of the scene's instances."""
        parts = self._scene.shape_table.num_parts[self._scene.shape_index.long()].to(torch.int32)
        self.end_part.copy_(parts.cumsum(dim=1))
        self.first_part.copy_(self.end_part - parts)

    def clear(self, mask: Tensor, point: Tensor, *, point_index: int) -> None:
        """Clear the surroundings of points [m], world, (E, V, 3), in the environments of ``mask``, bool (E,).

        They are ``START``, which discards the goal of the previous episode, or ``GOAL``, which keeps the start clear.
        """
        copy_mask(self._mask, mask)
        self._point.copy_(point.reshape(self._point.shape))
        self._commands[point_index].launch(self._mask)
