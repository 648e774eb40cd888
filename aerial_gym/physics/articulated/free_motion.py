"""Whether something resists every motion of a vehicle that bends: an inertia, or a spring or damper in its joint.

A joint whose link is a point on its axis, or two that turn the same about one axis, leave a motion without inertia: efforts
along it have no finite acceleration, and what flies is NaN.
Letters: D joints, N = 6 + D coordinates of motion, D on a stand.
"""

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.physics.articulated.dynamics import equations
from aerial_gym.physics.articulated.motion import Places
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState

PLACES = 2.0**-24
"""Round-off of a place in float32: nobody knows an inertia whose lever is that share of the vehicle's size."""


def check_motions(tree: Tree, links: Links, reference: Tensor, held: Tensor, names: tuple[str, ...]) -> None:
    """Raise ``ConfigError`` where a motion of the vehicle in its reference pose has no inertia.

    The mass matrix is weighed by what it would be if all mass that a coordinate moves were as far out as the vehicle is large;
    a motion has no inertia where that has an eigenvalue of at most N times the square of ``PLACES``.

    Args:
        links: What they weigh, float64, (1, L, ...).
        reference: Coordinates of the reference pose [rad] or [m], (D,).
        held: Whether a spring or damper is in the joint, whatever its position: it stands in for inertia within a step, (D,).
    """
    state = TreeState.at_rest(1, tree.num_joints, like=reference)
    state.joint_pos.copy_(reference)
    found = equations(tree, links, state, gravity=0.0)
    moved = links.mass[0] @ torch.tensor(tree.moves, dtype=reference.dtype)
    turns = torch.tensor([joint.kind == "revolute" for joint in tree.joints])
    size = _square_of_size(links, found.places)
    base = links.total_mass[0] * torch.stack((torch.ones_like(size),) * 3 + (size,) * 3)
    scale = torch.cat((base, moved * torch.where(turns, size, 1.0))).rsqrt()
    weighed = found.mass[0] * torch.outer(scale, scale) + torch.nn.functional.pad(held.to(scale), (6, 0)).diag()
    first = 0 if tree.floating else 6
    sizes, motions = torch.linalg.eigh(weighed[first:, first:])
    if sizes[0] > len(sizes) * PLACES**2:
        return
    share = motions[:, 0].abs()
    of = ("base",) * (6 - first) + names
    free = sorted({of[k] for k in range(len(of)) if share[k] > 1e-3 * share.max()}, key=of.index)
    raise ConfigError(
        f"robot: {', '.join(free)} can move in the reference pose without moving any mass, and no spring or damper is there. "
        "Give the link an inertia about the axis, or the joint a spring: {damping: ...}"
    )


def _square_of_size(links: Links, places: Places) -> Tensor:
    """Return the square of how large a vehicle is [m²]: its farthest place, and the mean square of what has no place."""
    farthest = torch.cat((places.com, places.origin), dim=1).square().sum(-1).max()
    return farthest + links.inertia[0].diagonal(dim1=-2, dim2=-1).sum() / links.total_mass[0, 0]
