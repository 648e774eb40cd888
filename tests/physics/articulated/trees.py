"""Trees, links and motions drawn at random."""

import numpy as np
import torch

from aerial_gym.physics.articulated.tree import Joint, Links, Tree, TreeState

F64 = torch.float64


def random_tree(num_joints: int, seed: int, *, floating: bool = True, chain: bool = False) -> Tree:
    """Return a tree of joints of both kinds in any direction; a chain hangs each link on the one before."""
    rng, joints = np.random.default_rng(seed), []
    for k in range(num_joints):
        axis, attitude = rng.normal(size=3), rng.normal(size=4)
        joints.append(
            Joint(
                parent=k if chain else int(rng.integers(0, k + 1)),
                kind="prismatic" if rng.random() < 0.25 else "revolute",
                axis=tuple((axis / np.linalg.norm(axis)).tolist()),
                position=tuple(rng.uniform(-0.2, 0.2, 3).tolist()),
                attitude=tuple((attitude / np.linalg.norm(attitude)).tolist()),
            )
        )
    return Tree(joints=tuple(joints), floating=floating)


def random_links(tree: Tree, num_envs: int, seed: int) -> Links:
    rng, shape = np.random.default_rng(seed + 1), (num_envs, tree.num_links)
    mass = rng.uniform(0.1, 1.0, shape)
    spread = rng.normal(size=(*shape, 8, 3)) * 0.05  # eight points, an eighth of the mass each
    spread -= spread.mean(axis=2, keepdims=True)
    second = np.einsum("elpa,elpb->elab", spread, spread) / 8.0
    inertia = mass[..., None, None] * (np.trace(second, axis1=2, axis2=3)[..., None, None] * np.eye(3) - second)
    com = rng.uniform(-0.1, 0.1, (*shape, 3))
    return Links(mass=torch.from_numpy(mass), com=torch.from_numpy(com), inertia=torch.from_numpy(inertia))


def random_motion(tree: Tree, num_envs: int, seed: int) -> TreeState:
    """Return trees in any attitude that move and turn; a base that stands still does neither."""
    rng = np.random.default_rng(seed + 2)

    def draw(width: int, scale: float) -> torch.Tensor:
        return torch.from_numpy(rng.normal(size=(num_envs, width)) * scale)

    attitude = torch.nn.functional.normalize(draw(4, 1.0), dim=-1)
    moves = float(tree.floating)
    return TreeState(
        position=draw(3, 1.0), attitude=attitude, lin_vel=moves * draw(3, 1.0), ang_vel=moves * draw(3, 2.0),
        joint_pos=draw(tree.num_joints, 0.7), joint_vel=draw(tree.num_joints, 2.0),
    )  # fmt: skip


def pendulum(length: float, mass: float) -> tuple[Tree, Links]:
    """Return a point mass on a fixed base, on a link of a length [m] that hangs down and turns about y."""
    tree = Tree(joints=(Joint(parent=0, axis=(0.0, 1.0, 0.0)),), floating=False)
    com = torch.tensor([[[0.0, 0.0, 0.0], [0.0, 0.0, -length]]], dtype=F64)
    weights = torch.tensor([[1.0, mass]], dtype=F64)
    return tree, Links(mass=weights, com=com, inertia=torch.zeros(1, 2, 3, 3, dtype=F64))
