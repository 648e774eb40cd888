"""Trees of links in any shape against an independent engine (MuJoCo): accelerations, mass matrix, motion."""

from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym.physics.articulated.dynamics import accelerations
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.mujoco.mjcf import write_mjcf
from tests.physics.articulated.trees import random_links, random_motion, random_tree

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
G = 9.81


def mujoco_model(tree: Tree, links: Links, env: int) -> Any:
    """Return the tree with the links of one environment in MuJoCo."""
    return mujoco.MjModel.from_xml_string(write_mjcf(tree, links, env=env, gravity=G, dt=1e-4, integrator="RK4"))


class MujocoEnv:
    """One environment in MuJoCo, set to a state; coordinates in our order."""

    def __init__(self, tree: Tree, links: Links, state: TreeState, env: int) -> None:
        self.tree, self.model = tree, mujoco_model(tree, links, env)
        self.data = mujoco.MjData(self.model)
        self.position = [int(self.model.joint(f"joint{k}").qposadr[0]) for k in range(tree.num_joints)]
        self.rate = [int(self.model.joint(f"joint{k}").dofadr[0]) for k in range(tree.num_joints)]
        if tree.floating:
            x, y, z, w = state.attitude[env].tolist()
            self.data.qpos[:7] = [*state.position[env].tolist(), w, x, y, z]
            self.data.qvel[:6] = [*state.lin_vel[env].tolist(), *state.ang_vel[env].tolist()]
        self.data.qpos[self.position] = state.joint_pos[env].numpy()
        self.data.qvel[self.rate] = state.joint_vel[env].numpy()

    def reorder(self, values: np.ndarray) -> np.ndarray:
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
        result = accelerations(tree, links, state, gravity=G, wrench=wrench, effort=effort)
        of_base = (result.lin_acc, result.ang_acc) if floating else ()
        actual = torch.cat((*of_base, result.joint_acc), dim=-1)
        for env in range(3):
            reference = MujocoEnv(tree, links, state, env)
            reference.push(wrench[env])
            reference.data.qfrc_applied[reference.rate] = effort[env].numpy()
            mujoco.mj_forward(reference.model, reference.data)
            expected = reference.reorder(reference.data.qacc)
            np.testing.assert_allclose(actual[env].numpy(), expected, rtol=0.0, atol=1e-8 * np.abs(expected).max())
