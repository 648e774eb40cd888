"""How a tree of links moves by Lagrange's equations, from energies alone: places by SciPy's rotations, all else by
differences. Coordinates x of a tree: place of the base (3), a rotation vector that turns it from its attitude, in its
own axes (3), joints. With ``T = x' M x' / 2`` and U: ``M x'' = -M' x' + dT/dx - dU/dx``. At a rotation vector of zero
its second derivative is the angular acceleration. Nothing is shared with the engine but the description of the tree."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from aerial_gym.physics.articulated.tree import Links, Tree, TreeState

Array = np.ndarray


@dataclass(frozen=True, kw_only=True)
class Energies:
    """Of one environment of a tree; numbers of links along their axes, (L, ...)."""

    tree: Tree
    attitude: Rotation  # Of the base where its rotation vector is zero

    mass: Array
    com: Array
    inertia: Array
    added: Array  # Added mass and added inertia, (L, 6)

    gravity: float
    push: Array  # Upward force, (L,)
    lever: Array  # Where it acts from the centre of mass, (L, 3)

    @classmethod
    def from_env(cls, tree: Tree, links: Links, state: TreeState, env: int, **rest: object) -> "Energies":
        """Return those of one environment; what is not given is zero."""
        count = tree.num_links
        empty = {"added": np.zeros((count, 6)), "push": np.zeros(count), "lever": np.zeros((count, 3)), "gravity": 0.0}
        mass, com, inertia = (rows.expand(env + 1, *rows.shape[1:])[env].numpy() for rows in vars(links).values())
        attitude = Rotation.from_quat(state.attitude[env].numpy())
        return cls(tree=tree, attitude=attitude, mass=mass, com=com, inertia=inertia, **(empty | rest))

    def places(self, x: Array) -> Array:
        """Return the centre of mass and the axes of each link, world, in columns, (L, 3, 4)."""
        turns, origins = [self.attitude * Rotation.from_rotvec(x[3:6])], [x[:3]]
        for joint, q in zip(self.tree.joints, x[6:], strict=True):
            turn, origin = turns[joint.parent], origins[joint.parent]
            mounted = turn * Rotation.from_quat(joint.attitude)
            origin, axis = origin + turn.apply(joint.position), np.array(joint.axis)
            bends = joint.kind == "revolute"
            turns.append(mounted * Rotation.from_rotvec(q * axis) if bends else mounted)
            origins.append(origin if bends else origin + q * mounted.apply(axis))
        axes = Rotation.concatenate(turns).as_matrix()
        centres = np.array(origins) + np.einsum("lij,lj->li", axes, self.com)
        return np.concatenate((centres[..., None], axes), axis=-1)

    def mass_matrix(self, x: Array) -> Array:
        """Return M of all links with the water that they move, from how differences of places move along each coordinate."""
        here, slopes = self.places(x)[..., 1:], _slopes(self.places, x)
        spin = slopes[..., 1:] @ here.transpose(0, 2, 1)  # skew matrices of the turning, world
        turning = np.stack((spin[..., 2, 1], spin[..., 0, 2], spin[..., 1, 0]), axis=-1)
        push, turn = (np.einsum("lji,alj->ali", here, part) for part in (slopes[..., 0], turning))  # axes of the links
        moved = self.mass[:, None] + self.added[:, :3]
        whirled = self.inertia + np.einsum("li,ij->lij", self.added[:, 3:], np.eye(3))
        return np.einsum("alj,lj,blj->ab", push, moved, push) + np.einsum("ali,lij,blj->ab", turn, whirled, turn)

    def potential(self, x: Array) -> float:
        centres, axes = self.places(x)[..., 0], self.places(x)[..., 1:]
        pushed = centres + np.einsum("lij,lj->li", axes, self.lever)
        return float(self.gravity * self.mass @ centres[:, 2] - self.push @ pushed[:, 2])

    def forces(self, x: Array) -> Array:
        return -_slopes(self.potential, x)

    def accelerations(self, x: Array, rate: Array) -> Array:
        slopes = _slopes(self.mass_matrix, x)  # (n, n, n), the coordinate first
        turned = np.einsum("kab,k,b->a", slopes, rate, rate) - 0.5 * np.einsum("kab,a,b->k", slopes, rate, rate)
        first = 0 if self.tree.floating else 6
        result = np.zeros_like(x)
        result[first:] = np.linalg.solve(self.mass_matrix(x)[first:, first:], (self.forces(x) - turned)[first:])
        return result


def coordinates(state: TreeState, env: int) -> tuple[Array, Array]:
    x = np.concatenate((state.position[env], np.zeros(3), state.joint_pos[env]))
    return x, np.concatenate((state.lin_vel[env], state.ang_vel[env], state.joint_vel[env]))


def _slopes(function: Callable[[Array], Array] | Callable[[Array], float], x: Array) -> Array:
    """Return derivatives along each coordinate, of order 4 in their step."""
    step, result = 3e-3, []
    for k in range(len(x)):
        side = np.zeros_like(x)
        side[k] = step
        near, far = (np.asarray(function(x + n * side)) - np.asarray(function(x - n * side)) for n in (1, 2))
        result.append((8.0 * near - far) / (12.0 * step))
    return np.array(result)
