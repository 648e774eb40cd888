"""Trees of links in any shape against an independent engine (MuJoCo): accelerations, mass matrix, motion."""

from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym.math.quaternion import quat_rotate, quat_to_matrix
from aerial_gym.physics.articulated.dynamics import accelerations, equations
from aerial_gym.physics.articulated.steppers import rk4
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.mujoco.mjcf import write_mjcf
from tests.physics.articulated.trees import random_links, random_motion, random_tree

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
G = 9.81


def model_of(tree: Tree, links: Links, env: int) -> Any:
    """Return the tree with the links of one environment in MuJoCo."""
    return mujoco.MjModel.from_xml_string(write_mjcf(tree, links, env=env, gravity=G, dt=1e-4, integrator="RK4"))


class Theirs:
    """One environment in MuJoCo, set to a state; coordinates in our order."""

    def __init__(self, tree: Tree, links: Links, state: TreeState, env: int) -> None:
        self.tree, self.model = tree, model_of(tree, links, env)
        self.data = mujoco.MjData(self.model)
        self.position = [int(self.model.joint(f"joint{k}").qposadr[0]) for k in range(tree.num_joints)]
        self.rate = [int(self.model.joint(f"joint{k}").dofadr[0]) for k in range(tree.num_joints)]
        if tree.floating:
            x, y, z, w = state.attitude[env].tolist()
            self.data.qpos[:7] = [*state.position[env].tolist(), w, x, y, z]
            self.data.qvel[:6] = [*state.lin_vel[env].tolist(), *state.ang_vel[env].tolist()]
        self.data.qpos[self.position] = state.joint_pos[env].numpy()
        self.data.qvel[self.rate] = state.joint_vel[env].numpy()

    def in_our_order(self, values: np.ndarray) -> np.ndarray:
        base = values[:6] if self.tree.floating else np.zeros(0)
        return np.concatenate((base, values[self.rate]))

    def push(self, wrench: torch.Tensor) -> None:
        """Apply forces and torques (L, 6) at the origins of links, in their axes."""
        mujoco.mj_kinematics(self.model, self.data)
        for link in range(self.tree.num_links):
            place = self.data.body(f"link{link}")
            turn = place.xmat.reshape(3, 3)
            force, torque = turn @ wrench[link, :3].numpy(), turn @ wrench[link, 3:].numpy()
            lever = place.xpos - place.xipos
            self.data.body(f"link{link}").xfrc_applied[:] = np.concatenate((force, torque + np.cross(lever, force)))


def level(state: TreeState) -> TreeState:
    """Return the state with the base at the world's origin and along its axes, where MuJoCo has one that stands still."""
    upright = torch.zeros_like(state.attitude)
    upright[:, 3] = 1.0
    return TreeState(**{**vars(state), "position": torch.zeros_like(state.position), "attitude": upright})


@pytest.mark.parametrize("floating", [True, False])
@pytest.mark.parametrize(("num_joints", "chain"), [(1, False), (4, False), (8, False), (12, True)])
def test_accelerations_of_random_trees_are_those_of_mujoco(num_joints: int, chain: bool, floating: bool) -> None:
    """With weights, forces on links and efforts of joints; both in float64: 1e-8 of the largest."""
    for seed in range(5):
        tree = random_tree(num_joints, seed, floating=floating, chain=chain)
        links, state = random_links(tree, 3, seed), random_motion(tree, 3, seed)
        state = state if floating else level(state)
        generator = torch.Generator().manual_seed(seed)
        wrench = torch.randn(3, tree.num_links, 6, generator=generator, dtype=torch.float64)
        effort = torch.randn(3, num_joints, generator=generator, dtype=torch.float64)
        found = accelerations(tree, links, state, gravity=G, wrench=wrench, effort=effort)
        of_base = (found.lin_acc, found.ang_acc) if floating else ()
        ours = torch.cat((*of_base, found.joint_acc), dim=-1)
        for env in range(3):
            theirs = Theirs(tree, links, state, env)
            theirs.push(wrench[env])
            theirs.data.qfrc_applied[theirs.rate] = effort[env].numpy()
            mujoco.mj_forward(theirs.model, theirs.data)
            expected = theirs.in_our_order(theirs.data.qacc)
            np.testing.assert_allclose(ours[env].numpy(), expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("floating", [True, False])
@pytest.mark.parametrize("chain", [False, True])
def test_their_inverse_dynamics_give_back_the_efforts_of_our_accelerations(chain: bool, floating: bool) -> None:
    """Forward here, inverse there (``mj_inverse``): the efforts of joints, and nothing on a base that is free."""
    tree = random_tree(9, 5, floating=floating, chain=chain)
    links, state = random_links(tree, 1, 5), random_motion(tree, 1, 5)
    state = state if floating else level(state)
    effort = torch.randn(1, 9, generator=torch.Generator().manual_seed(5), dtype=torch.float64)
    found = accelerations(tree, links, state, gravity=G, effort=effort)
    theirs = Theirs(tree, links, state, 0)
    theirs.data.qacc[theirs.rate] = found.joint_acc[0].numpy()
    if floating:
        theirs.data.qacc[:6] = torch.cat((found.lin_acc, found.ang_acc), dim=-1)[0].numpy()
    mujoco.mj_inverse(theirs.model, theirs.data)
    expected = torch.cat((torch.zeros(6 if floating else 0, dtype=torch.float64), effort[0])).numpy()
    np.testing.assert_allclose(theirs.in_our_order(theirs.data.qfrc_inverse), expected, atol=1e-9)


@pytest.mark.parametrize("chain", [False, True])
def test_the_mass_matrix_is_that_of_mujoco(chain: bool) -> None:
    """Ours has the velocity of the base in its own axes, theirs in the world's: the same after a turn."""
    tree = random_tree(7, 11, chain=chain)
    links, state = random_links(tree, 1, 11), random_motion(tree, 1, 11)
    theirs, dense = Theirs(tree, links, state, 0), np.zeros((13, 13))
    mujoco.mj_forward(theirs.model, theirs.data)
    mujoco.mj_fullM(theirs.model, theirs.data, dense)
    turn = np.eye(13)
    turn[:3, :3] = quat_to_matrix(state.attitude[0]).numpy()
    order = [*range(6), *theirs.rate]
    expected = turn.T @ dense[np.ix_(order, order)] @ turn
    np.testing.assert_allclose(equations(tree, links, state, gravity=G).mass[0].numpy(), expected, atol=1e-12)


def test_a_tenth_of_a_second_of_a_falling_tree_is_that_of_mujoco() -> None:
    """Both by RK4, ours at 1 ms, theirs at 0.1 ms: 1e-8 relative."""
    tree = random_tree(6, 3)
    links, state = random_links(tree, 2, 3), random_motion(tree, 2, 3)
    end = state
    for _ in range(100):
        end = rk4(tree, links, (), end, 1e-3, gravity=G)
    for env in range(2):
        theirs = Theirs(tree, links, state, env)
        for _ in range(1000):
            mujoco.mj_step(theirs.model, theirs.data)
        ours = torch.cat((end.lin_vel, end.ang_vel, end.joint_vel), dim=-1)[env].numpy()
        expected = theirs.in_our_order(theirs.data.qvel)
        np.testing.assert_allclose(ours, expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())
        np.testing.assert_allclose(end.joint_pos[env].numpy(), theirs.data.qpos[theirs.position], atol=1e-8)
        np.testing.assert_allclose(end.position[env].numpy(), theirs.data.qpos[:3], atol=1e-8)
        tip = quat_rotate(end.attitude[env], torch.ones(3, dtype=torch.float64))
        x, y, z = theirs.data.body("link0").xmat.reshape(3, 3) @ np.ones(3)
        np.testing.assert_allclose(tip.numpy(), (x, y, z), atol=1e-8)
