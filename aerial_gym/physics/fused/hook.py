"""The place of a ``SubstepHook`` in the fused kernel, and the twin of ``Trajectory``.

Letters: E environments, K substeps of a step.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from aerial_gym.physics.fused.functions import rotate


@dataclass(frozen=True)
class FusedHook:
    """A hook as Warp code."""

    struct: Any
    """``wp.struct`` of what it reads and writes."""

    data: Any
    """An instance, whose arrays stay where they are."""

    function: wp.Function
    """``(data, env, k, dt, mass, inertia, com, v0, w0, x, q, v, w) -> (x, q, v, w)`` after substep k: mass [kg], inertia about
    the centre of mass [kg m², body], com [m, body]; v0 [m/s, world] and w0 [rad/s, body] at its start, x, q, v, w at its end.
    Positions and velocities are those of the centre of mass."""


@wp.struct
class NoHook:
    """In the place of a hook's data where there is none: a launch costs the more the longer its arguments are."""

    nothing: int


@wp.struct
class TrajectoryArrays:
    """The pose after every substep."""

    position: wp.array2d[wp.vec3]  # (K, E) body origin, world [m]
    attitude: wp.array2d[wp.quat]  # (K, E) body to world, xyzw


@wp.func
def record(
    data: TrajectoryArrays,
    env: int,
    k: int,
    dt: float,
    mass: float,
    inertia: wp.mat33,
    com: wp.vec3,
    v0: wp.vec3,
    w0: wp.vec3,
    x: wp.vec3,
    q: wp.quat,
    v: wp.vec3,
    w: wp.vec3,
):
    """Write the pose and return the motion as it came."""
    data.position[k, env] = x - rotate(q, com)
    data.attitude[k, env] = q
    return x, q, v, w


def trajectory_hook(position: wp.array, attitude: wp.array) -> FusedHook:
    """Return the hook that writes these arrays, (K, E)."""
    data = TrajectoryArrays()
    data.position, data.attitude = position, attitude
    return FusedHook(TrajectoryArrays, data, record)
