"""Substep hooks in the fused kernel, and the Warp version of ``Trajectory``.

Letters: E environments, K substeps of a step, D joints.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from aerial_gym.math.warp_functions import rotate


@dataclass(frozen=True)
class FusedHook:
    """A hook as Warp code."""

    struct: Any  # ``wp.struct`` of the data that the hook reads and writes
    data: Any  # An instance of ``struct``, whose arrays keep their memory
    function: wp.Function  # `(data, env, k, done: Substep)` to position, attitude and both velocities after substep k
    joints: bool = False  # Whether the data has `joint_pos`, (K + 1, E, D), which the kernel with joints writes


@wp.struct
class Substep:
    """An integrated substep of one environment. Positions and velocities are those of the centre of mass."""

    dt: float  # [s]
    mass: float  # [kg]
    inertia: wp.mat33  # about the centre of mass, body [kg m²]
    com: wp.vec3  # from the body origin, body [m]
    first_position: wp.vec3  # at its start, world [m]
    first_attitude: wp.quat  # likewise
    first_lin_vel: wp.vec3  # likewise, world [m/s]
    first_ang_vel: wp.vec3  # likewise, body [rad/s]
    position: wp.vec3  # at its end, world [m]
    attitude: wp.quat  # body to world, xyzw
    lin_vel: wp.vec3
    ang_vel: wp.vec3


@wp.struct
class NoHook:
    """Small stand-in for absent hook data, because the cost of a launch grows with the size of its arguments."""

    unused: int


@wp.struct
class TrajectoryArrays:
    """The pose at the start of a step and after every substep."""

    position: wp.array2d[wp.vec3]  # (K + 1, E) body origin, world [m]
    attitude: wp.array2d[wp.quat]  # (K + 1, E) body to world, xyzw


@wp.struct
class JointTrajectoryArrays:
    """Poses and joint positions of an articulated vehicle at the start of a step and after every substep."""

    position: wp.array2d[wp.vec3]  # (K + 1, E) body origin, world [m]
    attitude: wp.array2d[wp.quat]  # (K + 1, E) body to world, xyzw
    joint_pos: wp.array3d[float]  # (K + 1, E, D) [rad] or [m]


@wp.func
def _record_poses(position: wp.array2d[wp.vec3], attitude: wp.array2d[wp.quat], env: int, k: int, done: Substep):
    """Write the pose after substep k, and for the first substep also the initial pose of the step."""
    if k == 0:
        position[0, env] = done.first_position - rotate(done.first_attitude, done.com)
        attitude[0, env] = done.first_attitude
    position[k + 1, env] = done.position - rotate(done.attitude, done.com)
    attitude[k + 1, env] = done.attitude


@wp.func
def record(data: TrajectoryArrays, env: int, k: int, done: Substep):
    """Write the poses and return the unchanged motion."""
    _record_poses(data.position, data.attitude, env, k, done)
    return done.position, done.attitude, done.lin_vel, done.ang_vel


@wp.func
def record_poses_with_joints(data: JointTrajectoryArrays, env: int, k: int, done: Substep):
    """Write the poses of a vehicle with joints and return the unchanged motion."""
    _record_poses(data.position, data.attitude, env, k, done)
    return done.position, done.attitude, done.lin_vel, done.ang_vel


def trajectory_hook(position: wp.array, attitude: wp.array, joint_pos: wp.array | None = None) -> FusedHook:
    """Return the hook that writes arrays of poses, (K + 1, E), and of joints, (K + 1, E, D)."""
    if joint_pos is None:
        data = TrajectoryArrays()
        data.position, data.attitude = position, attitude
        return FusedHook(TrajectoryArrays, data, record)
    jointed = JointTrajectoryArrays()
    jointed.position, jointed.attitude, jointed.joint_pos = position, attitude, joint_pos
    return FusedHook(JointTrajectoryArrays, jointed, record_poses_with_joints, joints=True)
