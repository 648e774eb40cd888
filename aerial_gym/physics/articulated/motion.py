"""Kinematics of the links of a tree, in axes of the base.

Pure functions of tensors. All vectors are in the axes of the base at this instant; velocities and accelerations are inertial,
so that Newton's and Euler's laws hold directly.
Letters: E environments, D joints, L = D + 1 links, N = 6 + D coordinates of motion: velocity and angular velocity of the base,
rates of the joints.

Sources:
    Kane, Levinson (1985), Dynamics: Theory and Applications, sections 2.14 (partial velocities) and 4.9 (accelerations);
    Featherstone (2008), Rigid Body Dynamics Algorithms, section 4.1 (trees).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_exp, quat_multiply, quat_to_matrix
from aerial_gym.math.rows import cross_product_matrix
from aerial_gym.physics.articulated.tree import Links, Tree

cross = torch.linalg.cross


@dataclass(frozen=True, kw_only=True)
class LinkPoses:
    """Poses and mass properties of links."""

    rotation: Tensor  # Rotation from each link to the base, (E, L, 3, 3)
    origin: Tensor  # Origin of each link from that of the base [m], (E, L, 3)
    axis: Tensor  # Direction of each joint, (E, D, 3)
    com: Tensor  # Centre of mass of each link from the origin of the base [m], (E, L, 3)
    inertia: Tensor  # Inertia of each link about its centre of mass [kg m²], (E, L, 3, 3)

    def to_link(self, vectors: Tensor) -> Tensor:
        """Rotate vectors (E, L, 3) from axes of the base into those of their links."""
        return (self.rotation.mT @ vectors.unsqueeze(-1)).squeeze(-1)


def place_links(tree: Tree, links: Links, joint_pos: Tensor) -> LinkPoses:
    """Return the poses of links for joint coordinates (E, D)."""
    num_envs, like = joint_pos.shape[0], joint_pos
    rotations = [torch.eye(3, dtype=like.dtype, device=like.device).expand(num_envs, 3, 3)]
    origins, axes = [like.new_zeros(num_envs, 3)], []
    for k, joint in enumerate(tree.joints):
        parent, own = rotations[joint.parent], like.new_tensor(joint.axis)
        mounted = parent @ quat_to_matrix(like.new_tensor(joint.attitude)).expand_as(parent)
        origin = origins[joint.parent] + _rotate(parent, like.new_tensor(joint.position))
        axis = _rotate(mounted, own)
        if joint.kind == "revolute":
            rotations.append(mounted @ quat_to_matrix(quat_exp(joint_pos[:, k : k + 1] * own)))
            origins.append(origin)
        else:
            rotations.append(mounted)
            origins.append(origin + axis * joint_pos[:, k : k + 1])
        axes.append(axis)
    rotation, origin = torch.stack(rotations, dim=1), torch.stack(origins, dim=1)
    return LinkPoses(
        rotation=rotation,
        origin=origin,
        axis=torch.stack(axes, dim=1) if axes else like.new_zeros(num_envs, 0, 3),
        com=origin + (rotation @ links.com.unsqueeze(-1)).squeeze(-1),
        inertia=rotation @ links.inertia @ rotation.transpose(-1, -2),
    )


def rotations_to_base(tree: Tree, joint_pos: Tensor) -> Tensor:
    """Return the rotation from each link to the base as quaternions, xyzw, (E, L, 4), for joint coordinates (E, D)."""
    attitudes = [joint_pos.new_tensor((0.0, 0.0, 0.0, 1.0)).expand(joint_pos.shape[0], 4)]
    for k, joint in enumerate(tree.joints):
        parent = attitudes[joint.parent]
        mounted = quat_multiply(parent, joint_pos.new_tensor(joint.attitude).expand_as(parent))
        bends = joint.kind == "revolute"
        turn = quat_exp(joint_pos[:, k : k + 1] * joint_pos.new_tensor(joint.axis)) if bends else None
        attitudes.append(mounted if turn is None else quat_multiply(mounted, turn))
    return torch.stack(attitudes, dim=1)


def _rotate(rotation: Tensor, vector: Tensor) -> Tensor:
    """Return ``rotation @ vector``, (E, 3), for a shared vector (3,), with an order of sums independent of E."""
    x, y, z = vector.unbind()
    return rotation[..., 0] * x + rotation[..., 1] * y + rotation[..., 2] * z


def angular_jacobian(tree: Tree, places: LinkPoses) -> Tensor:
    """Return the angular Jacobian: angular velocity of each link per coordinate of motion, (E, L, 3, N)."""
    like, num_envs = places.axis, places.axis.shape[0]
    base = torch.eye(3, dtype=like.dtype, device=like.device).expand(num_envs, tree.num_links, 3, 3)
    turns = _mask_of_joints(tree, like, "revolute").unsqueeze(2) * places.axis.transpose(1, 2).unsqueeze(1)
    return torch.cat((torch.zeros_like(base), base, turns), dim=-1)


def point_jacobian(tree: Tree, places: LinkPoses, points: Tensor) -> Tensor:
    """Return the Jacobian of points of links, (E, L, 3) from the base's origin: velocity per coordinate, (E, L, 3, N)."""
    like, num_envs = places.axis, places.axis.shape[0]
    base = torch.eye(3, dtype=like.dtype, device=like.device).expand(num_envs, tree.num_links, 3, 3)
    lever = points.unsqueeze(2) - places.origin[:, 1:].unsqueeze(1)  # (E, L, D, 3)
    swept = cross(places.axis.unsqueeze(1).expand_as(lever), lever)
    slid = places.axis.unsqueeze(1).expand_as(lever)
    joints = _mask_of_joints(tree, like, "revolute").unsqueeze(-1) * swept
    joints = joints + _mask_of_joints(tree, like, "prismatic").unsqueeze(-1) * slid
    return torch.cat((base, -cross_product_matrix(points), joints.transpose(2, 3)), dim=-1)


@dataclass(frozen=True, kw_only=True)
class LinkMotion:
    """Velocities of links, and their accelerations at zero acceleration of all coordinates."""

    ang_vel: Tensor  # [rad/s], (E, L, 3)
    lin_vel: Tensor  # Of the origins [m/s], (E, L, 3)
    ang_acc: Tensor  # [rad/s²], (E, L, 3)
    lin_acc: Tensor  # Of the origins [m/s²], (E, L, 3)
    com_acc: Tensor  # Of the centres of mass [m/s²], (E, L, 3)


def move_links(tree: Tree, places: LinkPoses, lin_vel: Tensor, ang_vel: Tensor, joint_vel: Tensor) -> LinkMotion:
    """Return the motion for velocity [m/s] and angular velocity [rad/s] of the base, (E, 3), and rates of joints, (E, D)."""
    turns, moves = [ang_vel], [lin_vel]
    bends, pulls = [torch.zeros_like(ang_vel)], [torch.zeros_like(lin_vel)]
    for k, joint in enumerate(tree.joints):
        turn, parent = turns[joint.parent], joint.parent
        lever = places.origin[:, k + 1] - places.origin[:, parent]
        own = places.axis[:, k] * joint_vel[:, k : k + 1]
        swept = cross(turn, lever)
        pull = pulls[parent] + cross(bends[parent], lever) + cross(turn, swept)
        if joint.kind == "revolute":
            turns.append(turn + own)
            moves.append(moves[parent] + swept)
            bends.append(bends[parent] + cross(turn, own))
            pulls.append(pull)
        else:
            turns.append(turn)
            moves.append(moves[parent] + swept + own)
            bends.append(bends[parent])
            pulls.append(pull + 2.0 * cross(turn, own))
    turn, bend, pull = (torch.stack(parts, dim=1) for parts in (turns, bends, pulls))
    lever = places.com - places.origin
    return LinkMotion(
        ang_vel=turn,
        lin_vel=torch.stack(moves, dim=1),
        ang_acc=bend,
        lin_acc=pull,
        com_acc=pull + cross(bend, lever) + cross(turn, cross(turn, lever)),
    )


def _mask_of_joints(tree: Tree, like: Tensor, kind: str) -> Tensor:
    """Return a mask with 1 for each joint of a kind that moves a link, (1, L, D)."""
    rows = [
        [float(moves and joint.kind == kind) for moves, joint in zip(row, tree.joints, strict=True)]
        for row in tree.joint_moves_link
    ]
    return like.new_tensor(rows).reshape(1, tree.num_links, tree.num_joints)
