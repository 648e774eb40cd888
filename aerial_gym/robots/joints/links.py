"""Pose and velocity of links, for the sensors, visible shapes and collision shapes on them.

The frame of a link equals the body frame in the reference pose, in which a robot file gives all positions. The pose of link
k is the product of exponentials of the joints from the base to it, each about its axis in the reference pose::

    X_k = X_parent exp(s_k (q_k - q_ref))
    w_k = w_parent + R_parent a_k q_k'        v_k = v_parent + w_parent x (x_k - x_parent) + R_parent a_k q_k' x (x_k - hinge)

of a revolute joint; a prismatic one keeps w_parent and adds R_parent a_k q_k' to the velocity. v_k is the velocity of the
frame's origin, which may be far from the link.
Source: Murray, Li, Sastry (1994), A Mathematical Introduction to Robotic Manipulation, section 3.2.2 (product of exponentials).
Frames: world z up; a link's as said. Letters: E environments, D joints, L = D + 1 links, the base first, K substeps of a step,
M pieces of a substep.
"""

import torch
import warp as wp

from aerial_gym.config.joint import JointsCfg
from aerial_gym.config.shape import BASE
from aerial_gym.interop import ReusableLaunch
from aerial_gym.physics import Trajectory
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.robots.joints.link_tensors import LinkTensors


@wp.struct
class _JointArrays:
    """The joints, in body axes of the reference pose."""

    parent: wp.array[wp.int32]  # (D,) link on which it sits
    slides: wp.array[wp.bool]  # (D,) whether it is prismatic
    axis: wp.array[wp.vec3]  # (D,)
    position: wp.array[wp.vec3]  # (D,) [m]
    reference: wp.array[float]  # (D,) [rad] or [m]


@wp.func
def _link_pose(joints: _JointArrays, k: int, x: wp.vec3, q: wp.quat, joint_pos: float):
    """Return the pose of joint k's link from that of its parent link."""
    bend = joint_pos - joints.reference[k]
    if joints.slides[k]:
        return x + wp.quat_rotate(q, bend * joints.axis[k]), q
    hinge = x + wp.quat_rotate(q, joints.position[k])
    turned = wp.normalize(q * wp.quat_from_axis_angle(joints.axis[k], bend))
    return hinge - wp.quat_rotate(turned, joints.position[k]), turned


@wp.kernel(enable_backward=False)
def _place_links_in_substeps(
    joints: _JointArrays,
    # state at the start of a step and after each substep
    position: wp.array2d[wp.vec3],  # (K + 1, E) of the base, world [m]
    attitude: wp.array2d[wp.quat],  # (K + 1, E) base to world, xyzw
    joint_pos: wp.array3d[float],  # (K + 1, E, D) [rad] or [m]
    pieces: int,  # M
    # out
    position_out: wp.array3d[wp.vec3],  # (K M + 1, E, L) world [m]
    attitude_out: wp.array3d[wp.quat],  # (K M + 1, E, L) link to world, xyzw
):
    """Write all link poses of an environment within a substep, at constant velocity of base and joints."""
    i, e = wp.tid()
    first = i // pieces
    last = wp.min(first + 1, position.shape[0] - 1)
    share = float(i - first * pieces) / float(pieces)
    position_out[i, e, 0] = wp.lerp(position[first, e], position[last, e], share)
    near = wp.where(wp.dot(attitude[first, e], attitude[last, e]) < 0.0, -attitude[last, e], attitude[last, e])
    attitude_out[i, e, 0] = wp.quat_slerp(attitude[first, e], near, share)
    if share == 0.0:
        position_out[i, e, 0] = position[first, e]
        attitude_out[i, e, 0] = attitude[first, e]
    for k in range(joint_pos.shape[2]):
        p = joints.parent[k]
        bend = wp.lerp(joint_pos[first, e, k], joint_pos[last, e, k], share)
        x, q = _link_pose(joints, k, position_out[i, e, p], attitude_out[i, e, p], bend)
        position_out[i, e, k + 1] = x
        attitude_out[i, e, k + 1] = q


@wp.kernel(enable_backward=False)
def _write_link_states(
    joints: _JointArrays,
    # state
    position: wp.array[wp.vec3],  # (E,) of the base, world [m]
    attitude: wp.array[wp.quat],  # (E,) base to world, xyzw
    lin_vel: wp.array[wp.vec3],  # (E,) world [m/s]
    ang_vel: wp.array[wp.vec3],  # (E,) base axes [rad/s]
    joint_pos: wp.array2d[float],  # (E, D) [rad] or [m]
    joint_vel: wp.array2d[float],  # (E, D) [rad/s] or [m/s]
    # out
    position_out: wp.array2d[wp.vec3],  # (E, L) world [m]
    attitude_out: wp.array2d[wp.quat],  # (E, L) link to world, xyzw
    lin_vel_out: wp.array2d[wp.vec3],  # (E, L) world [m/s]
    ang_vel_world_out: wp.array2d[wp.vec3],  # (E, L) world [rad/s]
    ang_vel_out: wp.array2d[wp.vec3],  # (E, L) axes of the link [rad/s]
):
    """Write pose and velocity of all links of an environment."""
    e = wp.tid()
    position_out[e, 0] = position[e]
    attitude_out[e, 0] = attitude[e]
    lin_vel_out[e, 0] = lin_vel[e]
    ang_vel_world_out[e, 0] = wp.quat_rotate(attitude[e], ang_vel[e])
    ang_vel_out[e, 0] = ang_vel[e]
    for k in range(joint_pos.shape[1]):
        p = joints.parent[k]
        x = position_out[e, p]
        q = attitude_out[e, p]
        axis = wp.quat_rotate(q, joints.axis[k])
        rate = joint_vel[e, k] * axis
        place, turned = _link_pose(joints, k, x, q, joint_pos[e, k])
        spin = ang_vel_world_out[e, p]
        velocity = lin_vel_out[e, p] + wp.cross(spin, place - x)
        if joints.slides[k]:
            velocity += rate
        else:
            velocity += wp.cross(rate, place - x - wp.quat_rotate(q, joints.position[k]))
            spin += rate
        position_out[e, k + 1] = place
        attitude_out[e, k + 1] = turned
        lin_vel_out[e, k + 1] = velocity
        ang_vel_world_out[e, k + 1] = spin
        ang_vel_out[e, k + 1] = wp.quat_rotate_inv(turned, spin)


def _joint_arrays(cfg: JointsCfg, place: wp.Device) -> _JointArrays:
    table = _JointArrays()
    table.parent = wp.array([cfg.link_number(joint.parent) for joint in cfg.layout], dtype=wp.int32, device=place)
    table.slides = wp.array([joint.kind == "prismatic" for joint in cfg.layout], dtype=wp.bool, device=place)
    table.axis = wp.array([joint.axis for joint in cfg.layout], dtype=wp.vec3, device=place)
    table.position = wp.array([joint.position for joint in cfg.layout], dtype=wp.vec3, device=place)
    table.reference = wp.array([joint.reference for joint in cfg.layout], dtype=wp.float32, device=place)
    return table


PIECES = 4
"""Pieces M of a substep for which links on other links are placed. Between two places a hinge that a turning link carries is
taken to move straight: of a link that turns by 0.3 rad per substep, 0.3 m from its own hinge, it is 0.2 mm off at most."""


class LinkTrajectory:
    """The poses of all links at the start of a step and after each piece of a substep, from a record of base and joints."""

    def __init__(self, cfg: JointsCfg, trajectory: Trajectory) -> None:
        """Take views of a record with joints, and make room for the links."""
        assert trajectory.joint_pos is not None
        device = trajectory.position.device
        self.pieces = 1 if all(joint.parent == BASE for joint in cfg.layout) else PIECES
        """Pieces M of a substep: one where all joints sit on the base."""
        rows, num_envs = trajectory.max_substeps * self.pieces + 1, trajectory.position.shape[1]
        size = (rows, num_envs, len(cfg.link_names))
        self.position = torch.zeros(*size, 3, device=device)
        """Origins of the frames [m], world, (K M + 1, E, L, 3)."""
        self.attitude = torch.zeros(*size, 4, device=device)
        """To the world, xyzw, (K M + 1, E, L, 4)."""
        place, base = wp.device_from_torch(device), (trajectory.position, trajectory.attitude)
        self._command = ReusableLaunch(
            _place_links_in_substeps, dim=size[:2],
            inputs=[_joint_arrays(cfg, place), *base, trajectory.joint_pos, self.pieces],
            outputs=[self.position, self.attitude], device=place,
        )  # fmt: skip

    def refresh(self) -> None:
        """Place all links of the step that has just ended; launched on torch's current stream, not waited for."""
        self._command.launch(self.position)


class LinkPlaces:
    """Writes the frames of the links; captured with the step that it belongs to."""

    def __init__(
        self, cfg: JointsCfg, state: ArticulatedState, links: LinkTensors, trajectory: Trajectory | None
    ) -> None:
        """Take views of the state, which must keep its memory, and of the outputs; follow a trajectory with joints."""
        followed = trajectory is not None and trajectory.joint_pos is not None
        self.trajectory = LinkTrajectory(cfg, trajectory) if followed and trajectory is not None else None
        """Link poses after each substep of the last step; None without a record."""
        place = wp.device_from_torch(state.position.device)
        table = _joint_arrays(cfg, place)
        base = (state.position, state.attitude, state.lin_vel, state.ang_vel)
        self._written = links.state
        self._command = ReusableLaunch(
            _write_link_states, dim=len(links.state), inputs=[table, *base, state.joint_pos, state.joint_vel],
            outputs=[*links.state.split((3, 4, 3, 3), dim=-1), links.ang_vel], device=place,
        )  # fmt: skip

    @torch.no_grad()
    def refresh(self) -> None:
        """Update all links from the state; launched on torch's current stream, not waited for."""
        self._command.launch(self._written)
