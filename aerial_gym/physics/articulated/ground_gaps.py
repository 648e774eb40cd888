"""Gaps between the links of an articulated vehicle and flat ground.

Frames: world, z up; spheres in the axes of their links, from their origins. Letters: E environments, C spheres.
"""

import torch
from torch import Tensor

from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.motion import move_links, place_links
from aerial_gym.physics.ground import Ground
from aerial_gym.physics.model import Model
from aerial_gym.physics.state import ArticulatedState


def sphere_gaps(ground: Ground, model: Model, state: ArticulatedState) -> tuple[Tensor, Tensor]:
    """Return the gaps of spheres to the ground [m], and the approach speeds of their lowest points [m/s], (E, C)."""
    articulation, spheres = model.articulation, ground.spheres.to(state.position.dtype)
    assert articulation is not None
    assert ground.on_links is not None
    on, tree = list(ground.on_links.links), articulation.tree
    places = place_links(tree, articulation.links(model.vehicle), state.joint_pos)
    moves = float(tree.floating)  # a stand is at rest, whatever its state
    body_vel = quat_rotate_inverse(state.attitude, moves * state.lin_vel)
    motion = move_links(tree, places, body_vel, moves * state.ang_vel, state.joint_vel)
    down = torch.zeros_like(state.position)
    down[:, 2] = -1.0
    down = quat_rotate_inverse(state.attitude, down).unsqueeze(1)
    lever = (places.rotation[:, on] @ spheres[:, :3, None]).squeeze(-1) + spheres[:, 3:] * down
    velocity = motion.lin_vel[:, on] + torch.linalg.cross(motion.ang_vel[:, on], lever)
    attitude = state.attitude.unsqueeze(1).expand(-1, len(on), -1)
    lowest = state.position[:, 2:] + quat_rotate(attitude, places.origin[:, on] + lever)[..., 2]
    return lowest - ground.height, (velocity * down).sum(-1)
