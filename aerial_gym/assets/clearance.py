"""Room around the robot's start and its goal: obstacles that stand there are drawn again, and parked if that fails.

An instance is drawn again until it is far enough from every point that is kept clear in this episode, at most
``NUM_ATTEMPTS`` times; one that never is, is parked. So the distance holds in every case, with a bounded amount of work, and
each instance is decided alone. Assets whose place is given rather than drawn (walls, rooms) are left where they are.
Frames: world of each environment, z up. Letters: E environments, A instances, K points.
"""

import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.geometry import signed_distance
from aerial_gym.assets.obstacles import Obstacles, draw_instance
from aerial_gym.assets.scene import PARKED_Z, Scene
from aerial_gym.assets.scene_arrays import ABSENT_BELOW, SceneArrays, part_attitude, part_position
from aerial_gym.interop import RecordedLaunch
from aerial_gym.math.random import take_mask

NUM_ATTEMPTS = 16
"""How often an instance is drawn again. If half of its range is blocked, 1 in 65,000 is parked."""

START, GOAL = 0, 1
"""The points that are kept clear."""


@wp.func
def _gap(
    scene: SceneArrays, env: int, first: int, end: int, start: wp.vec3, goal: wp.vec3, which: int, room: float
) -> float:
    """Return the least distance of parts ``first`` to ``end`` to the points up to ``which``, or ``room`` if that is smaller."""
    nearest = float(room)
    for k in range(which + 1):
        point = wp.where(k == 0, start, goal)
        for part in range(first, end):
            offset = point - part_position(scene, env, part)
            if wp.length(offset) - scene.radius[env, part] < nearest:
                local = wp.quat_rotate_inv(part_attitude(scene, env, part), offset)
                nearest = wp.min(nearest, signed_distance(scene.shapes[scene.part_shape[env, part]], local))
    return nearest


@wp.kernel(enable_backward=False)
def _clear(
    mask: wp.array[wp.bool],  # (E,)
    # scene
    scene: SceneArrays,
    first_part: wp.array2d[wp.int32],  # (E, A)
    end_part: wp.array2d[wp.int32],  # (E, A)
    # params
    point: wp.array[wp.vec3],  # (E,) the last of the points that count, world [m]
    which: int,  # START or GOAL
    room: float,  # [m]
    num_attempts: int,
    parked_z: float,  # [m]
    # out
    start_out: wp.array[wp.vec3],  # (E,) world [m]; written with START, read with GOAL
    obstacles_out: Obstacles,
):
    """Draw again, or park, the instances that stand too close; leave the others and other environments alone."""
    env, a = wp.tid()
    if not mask[env]:
        return
    goal = point[env]
    start = goal
    if which > 0:
        start = start_out[env]
    elif a == 0:
        start_out[env] = start
    if obstacles_out.table[obstacles_out.asset[env, a]].is_drawn == 0:
        return
    if obstacles_out.position[env, a][2] < ABSENT_BELOW:
        return
    first = first_part[env, a]
    end = end_part[env, a]
    gap = _gap(scene, env, first, end, start, goal, which, room)
    attempt = num_attempts * which  # start and goal have draws of their own
    last_attempt = attempt + num_attempts
    while gap < room and attempt < last_attempt:
        attempt += 1
        draw_instance(obstacles_out, env, a, attempt)
        gap = _gap(scene, env, first, end, start, goal, which, room)
    if gap < room:
        place = obstacles_out.position[env, a]
        obstacles_out.position[env, a] = wp.vec3(place[0], place[1], parked_z)
        obstacles_out.lin_vel[env, a] = wp.vec3(0.0, 0.0, 0.0)
        obstacles_out.ang_vel[env, a] = wp.vec3(0.0, 0.0, 0.0)


class Clearance:
    """Keeps start and goal of one robot per environment clear, with all views made at construction."""

    def __init__(self, scene: Scene, obstacles: Obstacles, *, mask: Tensor, room: float) -> None:
        """Take what may be moved.

        Args:
            obstacles: The same instances, and how they are drawn.
            mask: Of the environments whose obstacles may be moved, bool, (E,); kept.
            room: Least distance between a point and the surface of an instance [m].
        """
        envs, device = scene.num_envs, scene.device
        self._mask = mask
        self._point, self._start = torch.zeros(envs, 3, device=device), torch.zeros(envs, 3, device=device)
        self._scene = scene
        self._first_part, self._end_part = (torch.zeros_like(scene.shape_index) for _ in range(2))
        self.restart()
        inputs = [self._mask, scene.arrays, self._first_part, self._end_part, self._point]
        self._commands = [
            RecordedLaunch(
                _clear,
                dim=obstacles.asset.shape,
                inputs=[*inputs, which, room, NUM_ATTEMPTS, PARKED_Z],
                outputs=[self._start, obstacles],
                device=device,
            )
            for which in (START, GOAL)
        ]

    def restart(self) -> None:
        """Take the shapes that the instances of the scene now have."""
        parts = self._scene.shape_table.num_parts[self._scene.shape_index.long()].to(torch.int32)
        self._end_part.copy_(parts.cumsum(dim=1))
        self._first_part.copy_(self._end_part - parts)

    def clear(self, mask: Tensor, point: Tensor, *, which: int) -> None:
        """Make room around a point of masked environments, and keep the room around those before it.

        Args:
            mask: Environments whose obstacles may be moved, bool, (E,).
            point: What is kept clear [m], world, (E, 3).
            which: ``START``, which forgets the goal of the episode before, or ``GOAL``.
        """
        take_mask(self._mask, mask)
        self._point.copy_(point)
        self._commands[which].launch(self._mask)
