"""Draws inside kernels, from a state that follows from seed and counters alone."""

import warp as wp


@wp.func
def draw_vec3(random: wp.uint32, quantity: int, low: wp.vec3, high: wp.vec3) -> wp.vec3:
    """Return three uniform draws between ``low`` and ``high``; ``quantity`` tells the draws of one ``random`` apart."""
    stream = wp.rand_init(int(random), quantity)
    share = wp.vec3(wp.randf(stream), wp.randf(stream), wp.randf(stream))
    return low + wp.cw_mul(high - low, share)


@wp.func
def quat_of_angles(angles: wp.vec3) -> wp.quat:
    """Return the quaternion of ZYX Euler angles [rad], R = Rz(yaw) Ry(pitch) Rx(roll): ``quat_from_euler`` in a kernel."""
    roll = wp.quat(wp.sin(0.5 * angles[0]), 0.0, 0.0, wp.cos(0.5 * angles[0]))
    pitch = wp.quat(0.0, wp.sin(0.5 * angles[1]), 0.0, wp.cos(0.5 * angles[1]))
    yaw = wp.quat(0.0, 0.0, wp.sin(0.5 * angles[2]), wp.cos(0.5 * angles[2]))
    return wp.normalize(yaw * pitch * roll)
