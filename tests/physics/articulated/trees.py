"""Trees, links and motions drawn at random, and the quantities that they conserve."""

import numpy as np
import torch

from aerial_gym.math.quaternion import quat_rotate, quat_rotate_inverse
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.motion import cross, place_links
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


def kinetic_energy(tree: Tree, links: Links, state: TreeState) -> torch.Tensor:
    """Return the kinetic energy [J], (E,)."""
    system = equations_of_motion(tree, links, state, gravity=0.0)
    lin_vel = quat_rotate_inverse(state.attitude, state.lin_vel)
    rates = torch.cat((lin_vel, state.ang_vel, state.joint_vel), dim=-1)
    return 0.5 * torch.einsum("en,enm,em->e", rates, system.mass, rates)


def com_position(tree: Tree, links: Links, state: TreeState) -> torch.Tensor:
    """Return the centre of mass of all links [m], world, (E, 3)."""
    places = place_links(tree, links, state.joint_pos)
    mean = (links.mass.unsqueeze(-1) * places.com).sum(1) / links.total_mass
    return state.position + quat_rotate(state.attitude, mean)


def momenta(tree: Tree, links: Links, state: TreeState) -> tuple[torch.Tensor, torch.Tensor]:
    """Return momentum [kg m/s] and angular momentum about the world's origin [kg m²/s], world, (E, 3) each."""
    system = equations_of_motion(tree, links, state, gravity=0.0)
    places, motion, mass = system.places, system.motion, links.mass.unsqueeze(-1)
    velocity = motion.lin_vel + cross(motion.ang_vel, places.com - places.origin)
    push = mass * velocity
    spin = (places.inertia @ motion.ang_vel.unsqueeze(-1)).squeeze(-1)
    about_base = (spin + cross(places.com, push)).sum(1)
    momentum = quat_rotate(state.attitude, push.sum(1))
    return momentum, quat_rotate(state.attitude, about_base) + cross(state.position, momentum)
