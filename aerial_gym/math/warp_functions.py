"""Warp functions of vectors and quaternions for all kernels: roots, rotations, small linear systems, aligned memory.

The quaternion functions equal those of ``math.quaternion`` on one row; that module gives the sources.
Quaternions are xyzw, unit, body to world; body is x forward, y left, z up; world is z up.
"""

from typing import Any

import warp as wp


def vector_type(length: int) -> Any:
    """Return the type of a vector of floats."""
    return wp.types.vector(length=length, dtype=wp.float32)


# A correctly rounded root or quotient takes ten to twenty instructions and a branch on a GPU; each of these takes one, with a
# relative error of at most 2^-22.9 (PTX ISA 8.5, ``sqrt.approx``, ``rsqrt.approx`` and ``rcp.approx``).
_ROOT = """
#if defined(__CUDA_ARCH__)
    float root;
    asm("{name}.approx.ftz.f32 %0, %1;" : "=f"(root) : "f"(x));
    return root;
#else
    return {plain};
#endif
"""


@wp.func_native(_ROOT.format(name="rsqrt", plain="1.0f / wp::sqrt(x)"), "adj_x -= 0.5f * adj_ret / (x * wp::sqrt(x));")
def inverse_root(x: float) -> float:
    """Return ``1 / sqrt(x)`` for x > 0, on a GPU within two units in the last place."""


@wp.func_native(_ROOT.format(name="sqrt", plain="wp::sqrt(x)"), "adj_x += 0.5f * adj_ret / wp::sqrt(x);")
def root(x: float) -> float:
    """Return ``sqrt(x)`` for x >= 0, on a GPU within two units in the last place."""


@wp.func_native(_ROOT.format(name="rcp", plain="1.0f / x"), "adj_x -= adj_ret / (x * x);")
def reciprocal(x: float) -> float:
    """Return ``1 / x``, on a GPU within one unit in the last place."""


@wp.func
def unit(v: wp.vec3) -> wp.vec3:
    """Return ``v / |v|``, or zero for zero."""
    return inverse_root(wp.max(wp.dot(v, v), 1.0e-30)) * v


@wp.func
def unit_quat(q: wp.quat) -> wp.quat:
    """Return ``q / |q|``; zeros or NaN give NaN as in torch, so that the episode of that row ends."""
    return inverse_root(wp.dot(q, q)) * q


@wp.func
def rotate(q: wp.quat, v: wp.vec3) -> wp.vec3:
    """Return ``R(q) v``, body to world; the same polynomial of q as ``quat_rotate``, also where q is not quite unit."""
    u = wp.vec3(q[0], q[1], q[2])
    t = 2.0 * wp.cross(u, v)
    return v + q[3] * t + wp.cross(u, t)


@wp.func
def rotate_inverse(q: wp.quat, v: wp.vec3) -> wp.vec3:
    """Return ``R(q)^T v``, world to body."""
    u = wp.vec3(q[0], q[1], q[2])
    t = 2.0 * wp.cross(u, v)
    return v - q[3] * t + wp.cross(u, t)


@wp.struct
class _CholeskyFactor:
    """Lower triangular root L of a symmetric positive 3 x 3 matrix ``L Lᵀ``; its diagonal as reciprocals."""

    diagonal: wp.vec3
    below: wp.vec3  # entries 10, 20, 21


@wp.func
def _cholesky_root(a: wp.mat33) -> _CholeskyFactor:
    factor = _CholeskyFactor()
    x = 1.0 / wp.sqrt(a[0, 0])
    along = a[1, 0] * x
    far = a[2, 0] * x
    y = 1.0 / wp.sqrt(a[1, 1] - along * along)
    across = (a[2, 1] - far * along) * y
    z = 1.0 / wp.sqrt(a[2, 2] - far * far - across * across)
    factor.diagonal = wp.vec3(x, y, z)
    factor.below = wp.vec3(along, far, across)
    return factor


@wp.func
def _solve_lower(root: _CholeskyFactor, v: wp.vec3) -> wp.vec3:
    """Return ``L⁻¹ v``."""
    x = v[0] * root.diagonal[0]
    y = (v[1] - root.below[0] * x) * root.diagonal[1]
    return wp.vec3(x, y, (v[2] - root.below[1] * x - root.below[2] * y) * root.diagonal[2])


@wp.func
def _solve_upper(root: _CholeskyFactor, v: wp.vec3) -> wp.vec3:
    """Return ``L⁻ᵀ v``."""
    z = v[2] * root.diagonal[2]
    y = (v[1] - root.below[2] * z) * root.diagonal[1]
    return wp.vec3((v[0] - root.below[0] * y - root.below[1] * z) * root.diagonal[0], y, z)


@wp.func
def solve_motion(push: wp.mat33, mixed: wp.mat33, turn: wp.mat33, force: wp.vec3, torque: wp.vec3):
    """Return v and w with ``push v + mixedᵀ w = force`` and ``mixed v + turn w = torque``, by Cholesky's method.

    The matrix of the four blocks is symmetric and positive definite. Cholesky's method is backward stable: the error is that
    of float32 times the condition number (Higham, Accuracy and stability of numerical algorithms,
    chapter 10). By 3 x 3 inverses of cofactors the worst in a thousand contacts was five times as far off.
    """
    first = _cholesky_root(push)
    x = _solve_lower(first, wp.vec3(mixed[0, 0], mixed[0, 1], mixed[0, 2]))
    y = _solve_lower(first, wp.vec3(mixed[1, 0], mixed[1, 1], mixed[1, 2]))
    z = _solve_lower(first, wp.vec3(mixed[2, 0], mixed[2, 1], mixed[2, 2]))
    beside = wp.matrix_from_rows(x, y, z)
    second = _cholesky_root(turn - beside * wp.transpose(beside))
    moved = _solve_lower(first, force)
    turned = _solve_upper(second, _solve_lower(second, torque - beside * moved))
    return _solve_upper(first, moved - wp.transpose(beside) * turned), turned


@wp.func
def world_up(q: wp.quat) -> wp.vec3:
    """Return world z in body axes, ``R(q)^T z``: ``rotate_inverse`` of it, written out."""
    return wp.vec3(
        2.0 * (q[0] * q[2] - q[3] * q[1]), 2.0 * (q[1] * q[2] + q[3] * q[0]), 1.0 - 2.0 * (q[0] * q[0] + q[1] * q[1])
    )


@wp.func
def euler_angles(q: wp.quat) -> wp.vec3:
    """Return ZYX roll, pitch, yaw [rad]: ``math.quaternion.euler_from_quat``."""
    return wp.vec3(
        wp.atan2(2.0 * (q[3] * q[0] + q[1] * q[2]), 1.0 - 2.0 * (q[0] * q[0] + q[1] * q[1])),
        wp.asin(wp.clamp(2.0 * (q[3] * q[1] - q[2] * q[0]), -1.0, 1.0)),
        wp.atan2(2.0 * (q[3] * q[2] + q[0] * q[1]), 1.0 - 2.0 * (q[1] * q[1] + q[2] * q[2])),
    )


@wp.func(inline=False)
def rotation_quat_of_large_angle(rotation: wp.vec3, square: float) -> wp.quat:
    """Return the quaternion of any rotation vector [rad], as a separate call to save registers."""
    half = wp.sqrt(square)
    sine = 0.5 * wp.sin(half) / half
    return wp.quat(sine * rotation[0], sine * rotation[1], sine * rotation[2], wp.cos(half))


@wp.func
def rotation_matrix(q: wp.quat) -> wp.mat33:
    """Return R(q), body to world: ``rotate`` as a matrix (``wp.quat_to_matrix`` differs for q that is not unit)."""
    return wp.matrix_from_cols(
        rotate(q, wp.vec3(1.0, 0.0, 0.0)), rotate(q, wp.vec3(0.0, 1.0, 0.0)), rotate(q, wp.vec3(0.0, 0.0, 1.0))
    )


@wp.func
def rotation_quat(rotation: wp.vec3) -> wp.quat:
    """Return the quaternion of a rotation vector [rad], ``(sin(x/2)/x r, cos(x/2))``.

    Up to 1 rad the series are exact in float32 (next terms 1e-8); beyond it ``rotation_quat_of_large_angle`` is called.
    """
    square = 0.25 * wp.dot(rotation, rotation)
    if square > 0.25:
        return rotation_quat_of_large_angle(rotation, square)
    sine = 0.5 - square * (0.5 / 6.0 - square * (0.5 / 120.0 - square * (0.5 / 5040.0)))
    cosine = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square * (1.0 / 40320.0))))
    return wp.quat(sine * rotation[0], sine * rotation[1], sine * rotation[2], cosine)


@wp.func
def attitude_rate(q: wp.quat, ang_vel: wp.vec3) -> wp.quat:
    """Return ``q' = q (w, 0) / 2``."""
    return 0.5 * (q * wp.quat(ang_vel[0], ang_vel[1], ang_vel[2], 0.0))


# The compiler splits a vector of four numbers into four loads or stores of 4 bytes. These functions state that the address is
# aligned to 16 bytes (``WarpBackend`` checks that).
_LOAD = """
#if defined(__CUDA_ARCH__)
    const float4 v = *reinterpret_cast<const float4*>(source.data + i);
    return {kind}(v.x, v.y, v.z, v.w);
#else
    return source.data[i];
#endif
"""
_STORE = """
#if defined(__CUDA_ARCH__)
    *reinterpret_cast<float4*>(out.data + i) = make_float4(value[0], value[1], value[2], value[3]);
#else
    out.data[i] = value;
#endif
"""


@wp.func_native(_LOAD.replace("{kind}", "wp::quat_t<float>"))
def load_quat(source: wp.array[wp.quat], i: int) -> wp.quat:
    """Return element ``i`` of an array of quaternions, by one load of 16 bytes."""


@wp.func_native(_LOAD.replace("{kind}", "wp::vec_t<4, float>"))
def load_vec4(source: wp.array[wp.vec4], i: int) -> wp.vec4:
    """Return element ``i`` of an array of vectors of four numbers, by one load of 16 bytes."""


@wp.func_native(_STORE)
def store_quat(out: wp.array[wp.quat], i: int, value: wp.quat):
    """Write element ``i`` of an array of quaternions, by one store of 16 bytes."""


@wp.func_native(_STORE)
def store_vec4(out: wp.array[wp.vec4], i: int, value: wp.vec4):
    """Write element ``i`` of an array of vectors of four numbers, by one store of 16 bytes."""
