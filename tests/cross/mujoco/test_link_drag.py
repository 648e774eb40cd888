"""Drag of links against an independent engine (MuJoCo), which says itself how its bodies move; and on its backend."""

from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym.errors import CapabilityError
from aerial_gym.physics import BACKENDS, TorchBackend
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from tests.cross.mujoco.test_trees import MujocoEnv, level
from tests.cross.test_link_drag import OF_ALL, fly, with_drag
from tests.physics.articulated.test_link_drag import make_damping
from tests.physics.articulated.trees import random_links, random_motion, random_tree
from tests.repetitions import frequent_values

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")
G, SPAN, PROBE = 9.81, 0.05, 1e-6

NUMBERS = {"lx": 0.3, "ly": 0.1, "lz": 0.2, "qx": 0.2, "qy": 0.4, "qz": 0.1, "ax": 0.01, "az": 0.02, "by": 0.01}

WIND = (2.0, -1.0, 0.5)


def link_poses(reference: MujocoEnv) -> tuple[np.ndarray, np.ndarray]:
    """Return centres of mass of links, (L, 3), and their axes, (L, 3, 3), world."""
    bodies = [reference.data.body(f"link{link}") for link in range(reference.tree.num_links)]
    return np.array([body.xipos for body in bodies]), np.array([body.xmat.reshape(3, 3) for body in bodies])


def drag_by_differences(reference: MujocoEnv) -> None:
    """Push each body against its motion, which differences of MuJoCo's own places along its velocity say."""
    data, model, seen = reference.data, reference.model, []
    here = data.qpos.copy()
    for side in (-PROBE, 0.0, PROBE):
        data.qpos[:] = here
        mujoco.mj_integratePos(model, data.qpos, data.qvel, side)
        mujoco.mj_kinematics(model, data)
        seen.append(link_poses(reference))
    data.qpos[:] = here
    (before, turned), (_, axes), (after, further) = seen
    through = (after - before) / (2.0 * PROBE) - np.array(WIND)
    spin = (further - turned) / (2.0 * PROBE) @ axes.transpose(0, 2, 1)
    turning = np.stack((spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]), axis=-1)
    letters = {k: np.array([NUMBERS.get(f"{k}{axis}", 0.0) for axis in "xyz"]) for k in "lqab"}
    for link, turn in enumerate(axes):
        wrench = []
        for velocity, linear, quadratic in (
            (through, letters["l"], letters["q"]),
            (turning, letters["a"], letters["b"]),
        ):
            own = turn.T @ velocity[link]
            wrench.append(-turn @ ((linear + quadratic * np.linalg.norm(own)) * own))
        data.body(f"link{link}").xfrc_applied[:] = np.concatenate(wrench)


def mujoco_motion(tree: Tree, links: Links, state: TreeState, dt: float) -> np.ndarray:
    """Return the joints and, of a free base, its motion after ``SPAN``; force is held over a step."""
    expected = MujocoEnv(tree, links, state, 0)
    expected.model.opt.timestep = dt
    for _ in range(round(SPAN / dt)):
        drag_by_differences(expected)
        mujoco.mj_step(expected.model, expected.data)
    base = expected.data.qpos[:3] if tree.floating else np.zeros(0)
    return np.concatenate((base, expected.data.qpos[expected.position], expected.reorder(expected.data.qvel)))


def package_motion(tree: Tree, links: Links, state: TreeState, dt: float) -> np.ndarray:
    wind = torch.tensor([WIND], dtype=torch.float64)
    for _ in range(round(SPAN / dt)):
        damping, _ = make_damping(tree, links, state, wind, **NUMBERS)
        state = implicit_euler(tree, links, (), state, dt, gravity=G, damping=damping)
    free = [state.position, state.lin_vel, state.ang_vel] if tree.floating else []
    return torch.cat((*free[:1], state.joint_pos, *free[1:], state.joint_vel), dim=-1)[0].numpy()


@pytest.mark.parametrize("floating", frequent_values([True, False], [True]))
def test_trees_with_drag_in_wind_move_as_in_mujoco(floating: bool) -> None:
    """Both of order 1 in the drag, extrapolated."""
    tree = random_tree(4, 6, floating=floating)
    links, start = random_links(tree, 1, 6), random_motion(tree, 1, 6)
    state = start if floating else level(start)
    coarse, fine = (package_motion(tree, links, state, dt) for dt in (5e-4, 2.5e-4))
    theirs_coarse, theirs_fine = (mujoco_motion(tree, links, state, dt) for dt in (2e-4, 1e-4))
    actual, expected = 2.0 * fine - coarse, 2.0 * theirs_fine - theirs_coarse
    assert np.abs(actual - expected).max() < 1e-4 * np.abs(expected).max()
    assert np.abs(fine - coarse).max() > 1e-3  # else the steps say nothing


def mujoco_backend() -> Any:
    return BACKENDS.get("mujoco")()


@pytest.mark.parametrize("name", ["morphy", "morphy_fixed_base"])
def test_the_backend_flies_as_torch_does_to_the_order_of_the_step(name: str) -> None:
    """Drag is held there and taken at the end here: after a number of steps they are off by ``dt²`` in the limit, and by less
    than half at half of it where soft arms do not follow yet."""
    robot, off = with_drag(name, OF_ALL), []
    for dt in (2e-4, 1e-4):
        ends = [
            fly(backend, robot, ("constant_wind",), torch.float64, dt=dt)
            for backend in (TorchBackend(), mujoco_backend())
        ]
        off.append([float((one - other).abs().max()) for one, other in zip(*ends, strict=True)])
    rates = slice(2, None) if name == "morphy" else slice(6, None)
    for coarse, fine in zip(off[0][rates], off[1][rates], strict=True):
        assert coarse < 5e-3
        assert coarse > 2.0 * fine or coarse < 1e-12


def test_what_cannot_be_held_through_a_step_is_refused() -> None:
    """An arm of 0.01625 kg in steps of 2 ms: 8.125 N s/m would stop it; the largest of the batch is 1.5 times what is given."""
    for drag, refused in ((5.4, False), (5.45, True)):
        robot = with_drag("morphy_fixed_base", {"azimuth_1.lx": drag})
        if not refused:
            fly(mujoco_backend(), robot, (), torch.float64)
            continue
        with pytest.raises(
            CapabilityError, match=r"holds drag of links through a step of 0.002 s.* 1.01 times .* 'warp'"
        ):
            fly(mujoco_backend(), robot, (), torch.float64)
