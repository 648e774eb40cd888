"""Check that every motion of an articulated vehicle has an inertia, or a spring or damper in its joint.

A joint whose link is a point on its axis, or two joints about the same axis, leave a motion without inertia. Efforts along it
have no finite acceleration, and the state becomes NaN.
Letters: D joints, N = 6 + D coordinates of motion, D on a stand.
"""

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.physics.articulated.dynamics import equations
from aerial_gym.physics.articulated.motion import LinkPoses
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState

PLACES = 2.0**-24
"""Round-off of a position in float32; an inertia with a lever of that share of the vehicle's size is unknown."""


def check_motion_inertias(tree: Tree, links: Links, reference: Tensor, held: Tensor, names: tuple[str, ...]) -> None:
    """Raise ``ConfigError`` for a motion of the vehicle without inertia in its reference pose.

    The mass matrix is scaled by the inertia that each coordinate would move at the vehicle's full size. A motion has no inertia
    if the scaled matrix has an eigenvalue of at most N times the square of ``PLACES``.

    Args:
        links: Masses and inertias, float64, (1, L, ...).
        reference: Coordinates of the reference pose [rad] or [m], (D,).
        held: Whether the joint always has a spring or damper, which replaces inertia within a step, (D,).
    """
    state = TreeState.at_rest(1, tree.num_joints, like=reference)
    state.joint_pos.copy_(reference)
    system = equations(tree, links, state, gravity=0.0)
    moved = links.mass[0] @ torch.tensor(tree.moves, dtype=reference.dtype)
    turns = torch.tensor([joint.kind == "revolute" for joint in tree.joints])
    size = _square_of_size(links, system.places)
    base = links.total_mass[0] * torch.stack((torch.ones_like(size),) * 3 + (size,) * 3)
    scale = torch.cat((base, moved * torch.where(turns, size, 1.0))).rsqrt()
    weighed = system.mass[0] * torch.outer(scale, scale) + torch.nn.functional.pad(held.to(scale), (6, 0)).diag()
    first = 0 if tree.floating else 6
    sizes, motions = torch.linalg.eigh(weighed[first:, first:])
    if sizes[0] > len(sizes) * PLACES**2:
        return
    share = motions[:, 0].abs()
    of = ("base",) * (6 - first) + names
    free = sorted({of[k] for k in range(len(of)) if share[k] > 1e-3 * share.max()}, key=of.index)
    raise ConfigError(
        f"robot: {', '.join(free)} can move in the reference pose without moving any mass, and has no spring or damper. "
        "Give the link an inertia about the axis, or the joint a spring: {damping: ...}"
    )


def _square_of_size(links: Links, places: LinkPoses) -> Tensor:
    """Return a vehicle's size squared [m²]: that of its farthest point, plus the inertia of its links over the mass."""
    farthest = torch.cat((places.com, places.origin), dim=1).square().sum(-1).max()
    return farthest + links.inertia[0].diagonal(dim1=-2, dim2=-1).sum() / links.total_mass[0, 0]
