"""Continuous collision detection of a robot's spheres with a part at rest, between two poses of a step.

The search is that of ``sweep``, for a centre that moves along a line and around an axis, in the frame of the part.
"""

import warp as wp

from aerial_gym.assets.geometry import primitive_distance, primitive_normal, support
from aerial_gym.assets.scene_arrays import Shape
from aerial_gym.assets.sweep import MAX_STEPS, NEAR, make_path, relative_sagitta, time_to_plane


@wp.func
def _ball_touches(
    shape: Shape, start: wp.vec3, shift: wp.vec3, across: wp.vec3, beside: wp.vec3, angle: float, radius: float
) -> wp.bool:
    """Return whether a ball touches a part at rest that is no mesh, between times 0 and 1.

    At time t its centre is at ``start + t shift + cos(t angle) across + sin(t angle) beside``, in the frame of the part [m].
    """
    speed = wp.length(shift) + angle * wp.length(across)
    t = wp.float32(0.0)
    k = wp.int32(0)
    while k < wp.static(MAX_STEPS):
        k += 1
        cosine = wp.cos(t * angle)
        sine = wp.sin(t * angle)
        center = start + t * shift + cosine * across + sine * beside
        distance = primitive_distance(shape, center) - radius
        left = 1.0 - t
        if distance - NEAR > left * speed:
            return False
        if distance < 0.0:
            return True
        normal = primitive_normal(shape, center)
        towards = -wp.dot(normal, shift + angle * (cosine * beside - sine * across))
        bend = angle * angle * wp.length(wp.vec2(wp.dot(normal, across), wp.dot(normal, beside)))
        height = wp.dot(normal, center) - support(shape, normal) - radius
        wait = wp.max(distance - 0.5 * NEAR, 0.0) / wp.max(speed, 1.0e-20)
        if height >= -0.25 * NEAR:
            safe = wp.max(height - 0.5 * NEAR, 0.5 * wp.max(height, 0.0))  # the rest is a margin for rounding
            wait = wp.max(wait, time_to_plane(safe, towards, bend))
        if wait >= left:
            return False
        if distance < NEAR:
            return True
        t += wait
    return True


@wp.func
def spheres_touch_static(
    shape: Shape, x: wp.vec3, q: wp.quat, _radius: float, body: wp.array[wp.vec4], _hull: float, pivot: wp.vec3,
    position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], env: int,
) -> wp.bool:  # fmt: skip
    """Return whether a sphere touches the part, as ``touches_static`` does.

    The nearest pair at the last pose gives a plane. It clears nearly all substeps, those wholly above it, at once.
    """
    origin = x + wp.quat_rotate(q, shape.position)
    turn = q * shape.attitude
    last = position.shape[0] - 1
    c = wp.int32(0)
    while c < body.shape[0]:
        center = wp.vec3(body[c][0], body[c][1], body[c][2])
        ball = body[c][3]
        lever = wp.length(center - pivot)
        local = wp.quat_rotate_inv(turn, position[last, env] + wp.quat_rotate(attitude[last, env], center) - origin)
        normal = primitive_normal(shape, local)
        outward = wp.quat_rotate(turn, normal)
        surface = support(shape, normal) + ball + NEAR
        k = wp.int32(0)
        while k < last:
            x0 = position[k, env]
            q0 = attitude[k, env]
            k += 1
            x1 = position[k, env]
            q1 = attitude[k, env]
            before = wp.dot(outward, x0 + wp.quat_rotate(q0, center) - origin)
            after = wp.dot(outward, x1 + wp.quat_rotate(q1, center) - origin)
            if wp.min(before, after) <= surface + lever * relative_sagitta(q0, q1):
                path = make_path(pivot, x0, q0, x1, q1)
                angle = wp.length(path.turn)
                axis = path.turn / wp.max(angle, 1.0e-20)
                arm = wp.quat_rotate(q0, center - pivot)
                along = wp.dot(axis, arm) * axis
                if _ball_touches(
                    shape,
                    wp.quat_rotate_inv(turn, path.start + along - origin),
                    wp.quat_rotate_inv(turn, path.shift),
                    wp.quat_rotate_inv(turn, arm - along),
                    wp.quat_rotate_inv(turn, wp.cross(axis, arm)),
                    angle,
                    ball,
                ):
                    return True
        c += 1
    return False
