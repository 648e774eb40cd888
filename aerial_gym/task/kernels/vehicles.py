"""Kernels over the vehicles of an environment: the nearest neighbours of each, and conditions and rewards in common.

Frames: world of each environment, z up; vehicle is the world turned by the yaw. Letters: E environments, V vehicles of each,
B = E V rows, K neighbours or terminations, T terms of the reward.
"""

from collections.abc import Sequence

import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import ReusableLaunch, start_warp


@wp.kernel(enable_backward=False)
def _write_nearest(
    # state
    position: wp.array[wp.vec3],  # (B,) world [m]
    velocity: wp.array[wp.vec3],  # (B,) world [m/s]
    level: wp.array[wp.quat],  # (B,) vehicle frame to world, xyzw
    # params
    num_vehicles: int,
    count: int,
    # out
    nearest_out: wp.array2d[float],  # (B, 7 K)
):
    """Write the K nearest vehicles of the same environment; of two at the same distance, the lower number comes first."""
    row = wp.tid()
    first = row - row % num_vehicles
    least = wp.float32(-1.0)
    behind = wp.int32(-1)
    for k in range(count):
        nearest = wp.float32(wp.inf)
        choice = wp.int32(-1)
        for other in range(first, first + num_vehicles):
            distance = wp.length_sq(position[other] - position[row])
            follows = distance > least or (distance == least and other > behind)
            if other != row and follows and distance < nearest:
                nearest = distance
                choice = other
        offset = wp.vec3()
        motion = wp.vec3()
        there = wp.float32(0.0)
        if choice >= 0:
            offset = wp.quat_rotate_inv(level[row], position[choice] - position[row])
            motion = wp.quat_rotate_inv(level[row], velocity[choice] - velocity[row])
            there = 1.0
            least = nearest
        else:
            least = wp.float32(wp.inf)
        behind = choice
        for i in range(3):
            nearest_out[row, 7 * k + i] = offset[i]
            nearest_out[row, 7 * k + 3 + i] = motion[i]
        nearest_out[row, 7 * k + 6] = there


def make_nearest_launch(
    position: Tensor, velocity: Tensor, level: Tensor, *, num_vehicles: int, out: Tensor
) -> ReusableLaunch:
    """Return the launch that writes the K nearest vehicles of each row into ``out``, (B, 7 K).

    Args:
        position: Of the vehicles [m], world, (B, 3).
        velocity: [m/s], world, (B, 3).
        level: Vehicle frame to world, xyzw, (B, 4).
    """
    start_warp()
    inputs = [position, velocity, level, num_vehicles, out.shape[1] // 7]
    return ReusableLaunch(_write_nearest, dim=out.shape[0], inputs=inputs, outputs=[out], device=out.device)


@wp.kernel(enable_backward=False)
def _combine_rows(
    own_ends: wp.array2d[wp.bool],  # (B, K)
    own_rewards: wp.array2d[float],  # (B, T)
    # params
    least: wp.array[wp.int32],  # (K,) vehicles for which it must be true
    num_vehicles: int,
    # out
    ends_out: wp.array2d[wp.bool],  # (B, K)
    rewards_out: wp.array2d[float],  # (B, T)
):
    """Write counts and means over the vehicles of a row's environment, in the order of their numbers.

    A reward that is NaN or infinite is one of its own vehicle alone.
    """
    row, i = wp.tid()
    first = row - row % num_vehicles
    if i < own_ends.shape[1]:
        number = wp.int32(0)
        for other in range(first, first + num_vehicles):
            if own_ends[other, i]:
                number += 1
        ends_out[row, i] = number >= least[i]
    else:
        k = i - own_ends.shape[1]
        total = wp.float32(0.0)
        for other in range(first, first + num_vehicles):
            if other == row or wp.isfinite(own_rewards[other, k]):
                total += own_rewards[other, k]
        rewards_out[row, k] = total / float(num_vehicles)


def make_combination_launch(
    own: tuple[Tensor, Tensor], needs_all: Sequence[bool], *, num_vehicles: int, out: tuple[Tensor, Tensor]
) -> ReusableLaunch:
    """Return the launch that combines conditions, bool (B, K), and rewards (B, T) over the vehicles of each environment.

    ``needs_all`` says of each condition whether it must be true for all vehicles; otherwise one is enough.
    """
    start_warp()
    ends, rewards = out
    least = [num_vehicles if each else 1 for each in needs_all]
    inputs = [*own, torch.tensor(least, dtype=torch.int32, device=ends.device), num_vehicles]
    dim = (ends.shape[0], ends.shape[1] + rewards.shape[1])
    return ReusableLaunch(_combine_rows, dim=dim, inputs=inputs, outputs=list(out), device=ends.device)
