# pyright: reportArgumentType=false, reportCallIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportGeneralTypeIssues=false, reportAttributeAccessIssue=false, reportAssignmentType=false
# pyright: reportInvalidTypeForm=false, reportReturnType=false
# (Warp compiles the kernels from their source; Python's type rules do not describe them.)
"""Integrate suspended loads under moving origins, in float64 on the CPU, with one thread per origin.

The equation of motion is the simulator's. Letters: F origins, P parameters, N steps.
"""

from functools import cache

import torch
import warp as wp
from torch import Tensor

from aerial_gym.errors import ShapeError
from aerial_gym.interop import launch_on_cpu, start_warp
from aerial_gym.physics.effects import LoadEffect
from aerial_gym.physics.fused.formulas import make_pull


@wp.struct
class _Suspension:
    """``effects.SuspensionMotion`` in double precision."""

    acceleration: wp.vec3d  # gravity included [m/s²], world
    mobility: wp.mat33d  # acceleration per force [1/kg], world
    gravity: wp.float64  # [m/s²]


@wp.func
def _spatial_vector(top: wp.vec3d, bottom: wp.vec3d) -> wp.spatial_vectord:
    return wp.spatial_vectord(top[0], top[1], top[2], bottom[0], bottom[1], bottom[2])


def integrate_swing(
    effect: LoadEffect, params: Tensor, start: Tensor, acceleration: Tensor, *, step: float, gravity: float
) -> tuple[Tensor, Tensor]:
    """Return states of links (N + 1, F, 6) under moving origins and the forces on these [N], (N + 1, F, 3), world, by RK4.

    All float64: ``params`` (P,); ``start``: direction and rate, world, (F, 6); ``acceleration`` of the origins [m/s²],
    world, every half ``step`` [s], (2 N + 1, F, 3). Raise ``CapabilityError`` if the law cannot be traced, and
    ``ShapeError``.
    """
    rows, count = acceleration.shape[:2]
    if rows % 2 == 0 or tuple(start.shape) != (count, 6):
        raise ShapeError(
            f"start {tuple(start.shape)} and acceleration {tuple(acceleration.shape)}, expected (F, 6) and (2 N + 1, F, 3)"
        )
    start_warp()
    load, force = (torch.empty(rows // 2 + 1, count, width, dtype=torch.float64) for width in (6, 3))
    launch_on_cpu(
        lambda: _make_swing_kernel(effect),
        dim=count,
        inputs=[
            wp.from_torch(acceleration.contiguous(), dtype=wp.vec3d),
            wp.from_torch(start.contiguous(), dtype=wp.spatial_vectord),
            wp.types.vector(length=len(params), dtype=wp.float64)(*params.tolist()),
            wp.float64(gravity),
            wp.float64(step),
        ],
        outputs=[wp.from_torch(load, dtype=wp.spatial_vectord), wp.from_torch(force, dtype=wp.vec3d)],
    )
    return load, force


@cache
def _make_swing_kernel(effect: LoadEffect) -> wp.Kernel:
    """Return the kernel for an effect."""
    params_type = wp.types.vector(length=len(effect.parameters), dtype=wp.float64)
    pull = make_pull(effect, _Suspension, wp.spatial_vectord, wp.vec3d, params_type)

    @wp.func
    def swing_slope(acceleration: wp.vec3d, load: wp.spatial_vectord, params: params_type, gravity: wp.float64):
        at = _Suspension()  # zero mobility: the load does not move the prescribed origin
        at.acceleration = acceleration
        at.gravity = gravity
        force, swing = pull(at, load, params)
        return _spatial_vector(wp.spatial_bottom(load), swing), force

    @wp.kernel(module="unique", enable_backward=False)
    def integrate_links(
        acceleration: wp.array2d[wp.vec3d],  # (2 N + 1, F) [m/s²], world
        start: wp.array[wp.spatial_vectord],  # (F,) n, n' [1/s], world
        params: params_type,
        gravity: wp.float64,  # [m/s²]
        step: wp.float64,  # [s]
        # out
        load_out: wp.array2d[wp.spatial_vectord],  # (N + 1, F) n, n' [1/s], world
        force_out: wp.array2d[wp.vec3d],  # (N + 1, F) [N], world
    ):
        """Write link and force at the start and after each step, with ``|n| = 1``, ``n . n' = 0``."""
        origin = wp.tid()
        half = wp.float64(0.5) * step
        load = start[origin]
        k1, force = swing_slope(acceleration[0, origin], load, params, gravity)
        load_out[0, origin] = load
        force_out[0, origin] = force
        for row in range(1, load_out.shape[0]):
            middle, end = acceleration[2 * row - 1, origin], acceleration[2 * row, origin]
            k2, _f2 = swing_slope(middle, load + half * k1, params, gravity)
            k3, _f3 = swing_slope(middle, load + half * k2, params, gravity)
            k4, _f4 = swing_slope(end, load + step * k3, params, gravity)
            load += step / wp.float64(6.0) * (k1 + wp.float64(2.0) * (k2 + k3) + k4)
            direction = wp.normalize(wp.spatial_top(load))
            rate = wp.spatial_bottom(load)
            load = _spatial_vector(direction, rate - wp.dot(rate, direction) * direction)
            k1, force = swing_slope(end, load, params, gravity)
            load_out[row, origin] = load
            force_out[row, origin] = force

    return integrate_links
