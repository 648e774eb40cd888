"""Obstacle states and their random draws in kernels, by a table with one row of parameters for each asset.

The draw of an instance depends on its row, the attempt, the seed, the environment and the episode.
Frames: world of each environment, z up. Letters: E environments, A instances.
"""

from collections.abc import Sequence

import numpy as np
import torch
import warp as wp
from torch import Tensor

from aerial_gym.assets.scene_arrays import vector_view
from aerial_gym.config.environment import AT_BOUNDS, MOTIONS, AssetCfg
from aerial_gym.interop import make_struct, start_warp
from aerial_gym.math.draws import RandomArrays, draw_vec3, episode_stream, quat_from_angles, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness

STILL, TWIST, WAYPOINTS = (wp.constant(i) for i in range(len(MOTIONS)))  # Kinds of motion, in the order of `MOTIONS`
PASS, BOUNCE, WRAP = (wp.constant(i) for i in range(len(AT_BOUNDS)))  # Behaviour at the bounds, as in `AT_BOUNDS`


@wp.struct
class AssetRow:
    """Ranges of the draws of one asset's instances, and their motion."""

    ratio_low: wp.vec3  # place, as a share of the bounds
    ratio_high: wp.vec3
    offset: wp.vec3  # added to the place, world [m]
    euler_low: wp.vec3  # ZYX roll, pitch, yaw [rad]
    euler_high: wp.vec3
    lin_vel_low: wp.vec3  # world [m/s]
    lin_vel_high: wp.vec3
    ang_vel_low: wp.vec3  # world [rad/s]
    ang_vel_high: wp.vec3
    speed_low: wp.float32  # along waypoints [m/s]
    speed_high: wp.float32
    motion: wp.int32  # STILL, TWIST or WAYPOINTS
    at_bounds: wp.int32  # PASS, BOUNCE or WRAP
    is_drawn: wp.int32  # whether the place is drawn (1) or given (0)


def asset_table(assets: Sequence[AssetCfg], *, device: torch.device) -> wp.array:
    """Return the rows of all assets on the device."""
    start_warp()
    rows = np.zeros(len(assets), dtype=AssetRow.numpy_dtype())  # type: ignore[call-overload]
    for row, asset in zip(rows, assets, strict=True):
        motion = asset.motion
        row["ratio_low"], row["ratio_high"] = asset.position_ratio_low, asset.position_ratio_high
        row["offset"] = asset.offset
        row["euler_low"], row["euler_high"] = asset.euler_low, asset.euler_high
        row["lin_vel_low"], row["lin_vel_high"] = motion.lin_vel_low, motion.lin_vel_high
        row["ang_vel_low"], row["ang_vel_high"] = motion.ang_vel_low, motion.ang_vel_high
        row["speed_low"], row["speed_high"] = motion.speed
        row["motion"], row["at_bounds"] = MOTIONS.index(motion.kind), AT_BOUNDS.index(motion.at_bounds)
        row["is_drawn"] = asset.position_ratio_low != asset.position_ratio_high
    return wp.array(rows, dtype=AssetRow, device=wp.device_from_torch(device))


@wp.struct
class Obstacles:
    """States of all instances, and the parameters of their draws."""

    table: wp.array[AssetRow]
    asset: wp.array2d[wp.int32]  # (E, A) row of the table
    bounds_min: wp.array[wp.vec3]  # (E,) world [m]
    bounds_max: wp.array[wp.vec3]  # (E,) world [m]
    random: RandomArrays
    position: wp.array2d[wp.vec3]  # (E, A) world [m]
    attitude: wp.array2d[wp.quat]  # (E, A) instance to world, xyzw, unit
    lin_vel: wp.array2d[wp.vec3]  # (E, A) world [m/s]
    ang_vel: wp.array2d[wp.vec3]  # (E, A) world [rad/s]
    waypoint_a: wp.array2d[wp.vec3]  # (E, A) world [m]; empty where no asset has waypoints
    waypoint_b: wp.array2d[wp.vec3]


def view_obstacles(
    state: Tensor, waypoints: Tensor, *, table: wp.array, asset: Tensor, bounds: tuple[Tensor, Tensor],
    random: Randomness,
) -> Obstacles:  # fmt: skip
    """Return views of tensors, which must stay where they are.

    Args:
        state: Position, attitude, velocity and angular velocity, (E, A, 13); may be strided, but for the last axis.
        waypoints: Ends of the paths [m], world, (E, A, 2, 3); (0, 0, 2, 3) where no asset has waypoints.
        asset: Row of every instance, int32, (E, A), contiguous.
        bounds: Lower and upper corner [m], world, each (E, 3).
    """
    low, high = bounds
    arrays = make_struct(
        Obstacles, table=table, asset=asset, bounds_min=low, bounds_max=high, random=random_arrays(random),
        waypoint_a=waypoints[:, :, 0], waypoint_b=waypoints[:, :, 1],
    )  # fmt: skip
    for name, columns in (("position", (0, 3)), ("attitude", (3, 7)), ("lin_vel", (7, 10)), ("ang_vel", (10, 13))):
        view = state[..., slice(*columns)]
        setattr(arrays, name, vector_view(name, view, tuple(view.shape), device=state.device))
    return arrays


@wp.func
def _draw_position(random: wp.uint32, quantity: int, row: AssetRow, lower: wp.vec3, upper: wp.vec3) -> wp.vec3:
    """Draw a position; the weighted sum of both corners gives each corner exactly at ratio 0 and 1."""
    ratio = draw_vec3(random, quantity, row.ratio_low, row.ratio_high)
    return wp.cw_mul(wp.vec3(1.0, 1.0, 1.0) - ratio, lower) + wp.cw_mul(ratio, upper) + row.offset


@wp.func
def park_instance(obstacles: Obstacles, env: int, a: int, parked_z: float):
    """Move an instance to the parking height [m], at rest."""
    place = obstacles.position[env, a]
    obstacles.position[env, a] = wp.vec3(place[0], place[1], parked_z)
    obstacles.lin_vel[env, a] = wp.vec3(0.0, 0.0, 0.0)
    obstacles.ang_vel[env, a] = wp.vec3(0.0, 0.0, 0.0)


@wp.func
def draw_instance(obstacles: Obstacles, env: int, a: int, attempt: int):
    """Draw pose, twist and path of one instance."""
    row = obstacles.table[obstacles.asset[env, a]]
    random = substream(substream(episode_stream(obstacles.random, env, wp.static(int(Purpose.OBSTACLES))), a), attempt)
    lower = obstacles.bounds_min[env]
    upper = obstacles.bounds_max[env]
    place = _draw_position(random, 0, row, lower, upper)
    velocity = draw_vec3(random, 2, row.lin_vel_low, row.lin_vel_high)
    if row.motion == WAYPOINTS:
        other = _draw_position(random, 4, row, lower, upper)
        speed = row.speed_low + (row.speed_high - row.speed_low) * wp.randf(substream(random, 5))
        velocity = speed * wp.normalize(other - place)
        obstacles.waypoint_a[env, a] = place
        obstacles.waypoint_b[env, a] = other
    obstacles.position[env, a] = place
    obstacles.attitude[env, a] = quat_from_angles(draw_vec3(random, 1, row.euler_low, row.euler_high))
    obstacles.lin_vel[env, a] = velocity
    obstacles.ang_vel[env, a] = draw_vec3(random, 3, row.ang_vel_low, row.ang_vel_high)
