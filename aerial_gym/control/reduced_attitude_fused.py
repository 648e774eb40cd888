"""The reduced-attitude error in the fused kernel: the Warp version of ``control.reduced_attitude``."""

import warp as wp

from aerial_gym.math.warp_functions import rotate


@wp.func
def shortest_turn(a: wp.vec3, b: wp.vec3) -> wp.quat:
    """Return the quaternion of the shortest rotation from unit vectors a to b; zeros for opposite vectors."""
    cross = wp.cross(a, b)
    dot = wp.dot(a, b)
    turn = wp.quat()
    if wp.dot(cross, cross) >= 1.0e-10 or dot > 0.0:
        turn = wp.normalize(wp.quat(cross[0], cross[1], cross[2], 1.0 + dot))
    return turn


@wp.func
def canonical(q: wp.quat) -> wp.quat:
    """Return the equal rotation with ``w >= 0``."""
    return wp.where(q[3] < 0.0, -q, q)


@wp.func
def tilt_first_error(attitude: wp.quat, wanted: wp.quat, yaw_share: float) -> wp.vec3:
    """Return the Warp version of ``reduced_attitude.tilt_first_error``, body."""
    up = rotate(attitude, wp.vec3(0.0, 0.0, 1.0))
    turn = shortest_turn(up, rotate(wanted, wp.vec3(0.0, 0.0, 1.0)))
    tilted = wanted
    if wp.length_sq(turn) > 0.0:
        tilted = turn * attitude
    heading = canonical(wp.quat_inverse(tilted) * wanted)
    half = yaw_share * wp.atan2(heading[2], heading[3])
    part = wp.quat(0.0, 0.0, wp.sin(half), wp.cos(half))
    error = canonical(wp.quat_inverse(attitude) * (tilted * part))
    return wp.vec3(error[0], error[1], error[2])
