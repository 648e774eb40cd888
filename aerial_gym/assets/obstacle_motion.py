"""Motion of obstacles, all in one launch.

A twist is constant during a step: the origin moves by ``v dt`` in a straight line, and the attitude turns by exactly
``|w| dt`` about ``w``. Between waypoints, only the velocity component along the path counts.
Frames: velocities and angular velocities in the world frame. Letters: E environments, A instances.
"""

import warp as wp
from torch import Tensor

from aerial_gym.assets.obstacles import BOUNCE, PASS, STILL, TWIST, WAYPOINTS, WRAP, Obstacles
from aerial_gym.assets.scene_arrays import ABSENT_BELOW
from aerial_gym.interop import ReusableLaunch


@wp.func
def _reflect(x: float, v: float, low: float, high: float) -> wp.vec2:
    """Return position and velocity after reflection at a limit."""
    if x > high:
        return wp.vec2(wp.max(2.0 * high - x, low), -wp.abs(v))
    if x < low:
        return wp.vec2(wp.min(2.0 * low - x, high), wp.abs(v))
    return wp.vec2(x, v)


@wp.func
def _wrap_into_range(x: float, low: float, high: float) -> float:
    """Return the position wrapped into ``[low, high)``."""
    span = high - low
    return x - span * wp.floor((x - low) / span)


@wp.func
def is_present_and_moves(obstacles: Obstacles, env: int, a: int) -> wp.bool:
    """Return whether an instance is present and its asset moves."""
    still = obstacles.table[obstacles.asset[env, a]].motion == STILL
    return not still and obstacles.position[env, a][2] >= ABSENT_BELOW


@wp.func
def advance_pose(
    obstacles: Obstacles, env: int, a: int, position: wp.vec3, attitude: wp.quat, lin_vel: wp.vec3, dt: float
):  # fmt: skip
    """Return position, attitude and velocity of a moving instance after ``dt`` [s], without writing them."""
    row = obstacles.table[obstacles.asset[env, a]]
    velocity = lin_vel
    turn = obstacles.ang_vel[env, a]
    place = position + dt * velocity
    if row.motion == WAYPOINTS:
        from_a = obstacles.waypoint_a[env, a]
        path = obstacles.waypoint_b[env, a] - from_a
        along = wp.normalize(path)
        folded = _reflect(wp.dot(place - from_a, along), wp.dot(velocity, along), 0.0, wp.length(path))
        place = from_a + folded[0] * along
        if folded[1] * wp.dot(velocity, along) < 0.0:
            velocity = -velocity  # rather than folded[1] * along, whose rounding would slow it down in time
    elif row.at_bounds == BOUNCE:
        for i in range(3):
            folded = _reflect(place[i], velocity[i], obstacles.bounds_min[env][i], obstacles.bounds_max[env][i])
            place[i] = folded[0]
            velocity[i] = folded[1]
    elif row.at_bounds == WRAP:
        for i in range(3):
            place[i] = _wrap_into_range(place[i], obstacles.bounds_min[env][i], obstacles.bounds_max[env][i])
    rotation = wp.quat_from_axis_angle(wp.normalize(turn), dt * wp.length(turn))
    return place, wp.normalize(rotation * attitude), velocity


@wp.func
def _earliest_time(after: float, time: float, earliest: float) -> float:
    return wp.where(time > after and time < earliest, time, earliest)


@wp.func
def next_reversal(
    obstacles: Obstacles, env: int, a: int, position: wp.vec3, lin_vel: wp.vec3, dt: float, after: float
) -> float:
    """Return the next fraction of ``dt`` at which ``advance_pose`` reverses or wraps an instance; 1 if it does neither."""
    row = obstacles.table[obstacles.asset[env, a]]
    earliest = wp.float32(1.0)
    if row.motion == WAYPOINTS:
        path = obstacles.waypoint_b[env, a] - obstacles.waypoint_a[env, a]
        along = wp.normalize(path)
        place = wp.dot(position - obstacles.waypoint_a[env, a], along)
        step = dt * wp.dot(lin_vel, along)
        if step != 0.0:
            earliest = _earliest_time(after, (wp.where(step > 0.0, wp.length(path), 0.0) - place) / step, earliest)
    elif row.at_bounds != PASS:
        for i in range(3):
            step = dt * lin_vel[i]
            end = wp.where(step > 0.0, obstacles.bounds_max[env][i], obstacles.bounds_min[env][i])
            if step != 0.0:
                earliest = _earliest_time(after, (end - position[i]) / step, earliest)
    return earliest


@wp.func
def move_instance(obstacles: Obstacles, env: int, a: int, dt: float, steps: int):
    """Move a moving instance by ``steps`` of ``dt`` [s] each."""
    if is_present_and_moves(obstacles, env, a):
        x = obstacles.position[env, a]
        q = obstacles.attitude[env, a]
        v = obstacles.lin_vel[env, a]
        for _k in range(steps):
            x, q, v = advance_pose(obstacles, env, a, x, q, v, dt)
        obstacles.position[env, a] = x
        obstacles.attitude[env, a] = q
        obstacles.lin_vel[env, a] = v


@wp.kernel(enable_backward=False)
def _advance_instances(
    dt: float,  # [s]
    steps: int,
    # out
    obstacles_out: Obstacles,
):
    """Move the present instances of moving assets by ``steps`` of ``dt``."""
    env, a = wp.tid()
    move_instance(obstacles_out, env, a, dt, steps)


@wp.kernel(enable_backward=False)
def _set_twists(
    twist: wp.array3d[float],  # (E, A, 6) [m/s, rad/s]
    # out
    obstacles_out: Obstacles,
):
    """Write the given twists of instances that move by twist."""
    env, a = wp.tid()
    if obstacles_out.table[obstacles_out.asset[env, a]].motion != TWIST:
        return
    obstacles_out.lin_vel[env, a] = wp.vec3(twist[env, a, 0], twist[env, a, 1], twist[env, a, 2])
    obstacles_out.ang_vel[env, a] = wp.vec3(twist[env, a, 3], twist[env, a, 4], twist[env, a, 5])


def make_motion_launch(obstacles: Obstacles, dt: float, *, steps: int = 1) -> ReusableLaunch:
    """Record the launch that moves all obstacles by ``steps`` of ``dt`` [s]."""
    device = wp.device_from_torch(wp.to_torch(obstacles.asset).device)
    return ReusableLaunch(
        _advance_instances, dim=obstacles.asset.shape, inputs=[dt, steps], outputs=[obstacles], device=device
    )


def make_twist_launch(obstacles: Obstacles, twists: Tensor) -> ReusableLaunch:
    """Record the launch that takes velocities [m/s] and angular velocities [rad/s], world, float32, (E, A, 6)."""
    device = wp.device_from_torch(twists.device)
    return ReusableLaunch(_set_twists, dim=obstacles.asset.shape, inputs=[twists], outputs=[obstacles], device=device)
