"""Vehicles that bend on MuJoCo as a backend: its step of a tree against ``implicit_euler``, and against closed forms.
All in float64 but for whole simulations.
Drag of links against an independent engine (MuJoCo), which says itself how its bodies move; and on its backend.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym import SimBuilder
from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.math.quaternion import quat_from_euler
from aerial_gym.physics import BACKENDS, TorchBackend
from aerial_gym.physics.articulated.joint_laws import Drive, JointLimits, Spring
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Links, Tree, TreeState
from aerial_gym.physics.mujoco.rollouts import RolloutTrees
from aerial_gym.robots import ROBOTS
from tests.cross.mujoco.test_trees import MujocoEnv, level
from tests.cross.test_link_drag import OF_ALL, fly, with_drag
from tests.physics.articulated.test_link_drag import make_damping
from tests.physics.articulated.trees import random_links, random_motion, random_tree
from tests.physics.vehicles import F64
from tests.repetitions import frequent_values

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

G, DT = 9.81, 0.002


def spring(num_joints: int, *, stiffness=0.0, quadratic=0.0, damping=0.0, rest=0.0) -> Spring:
    values = {"stiffness": stiffness, "quadratic": quadratic, "damping": damping, "rest": rest}
    return Spring(
        **{k: torch.full((1, num_joints), v, dtype=F64) for k, v in values.items()},
        preload=torch.zeros(1, num_joints, dtype=F64),
    )


def no_wrench(tree: Tree, num_envs: int) -> torch.Tensor:
    return torch.zeros(num_envs, tree.num_links, 6, dtype=F64)


def assert_same(one: TreeState, other: TreeState, *, bound: float) -> None:
    for name, values in vars(one).items():
        size = 1.0 + values.abs().max().item()
        error = (getattr(other, name) - values).abs().max().item()
        assert error <= bound * size, f"{name}: {error:.1e}"


def on_a_stand(state: TreeState) -> TreeState:
    still = {name: torch.zeros_like(getattr(state, name)) for name in ("lin_vel", "ang_vel")}
    turns = torch.tensor([[0.3, -0.5, 0.2], [-1.0, 0.4, 0.0], [0.0, 0.0, 1.0]], dtype=F64)
    return replace(state, **still, attitude=quat_from_euler(turns))


@pytest.mark.parametrize(
    ("num_joints", "chain", "floating"),
    frequent_values(
        [(*tree, floating) for tree in ((1, False), (6, False), (10, True)) for floating in (True, False)],
        [(6, False, False), (10, True, True)],
    ),
)
def test_trees_move_as_by_implicit_euler(num_joints: int, chain: bool, floating: bool) -> None:
    """Forces on links, springs, soft ends, drives at their limits and not, links by environment: 50 steps to 1e-9. Condition
    numbers of mass matrices, some 1e4, and the growth of differences in 0.1 s stand between that and rounding."""
    tree = random_tree(num_joints, 5, floating=floating, chain=chain)
    links, first = random_links(tree, 3, 5), random_motion(tree, 3, 5)
    first = first if floating else on_a_stand(first)
    wrench = torch.randn(3, tree.num_links, 6, generator=torch.Generator().manual_seed(1), dtype=F64)
    ends = {"low": -0.1, "high": 0.2, "stiffness": 3.0, "damping": 0.02}
    laws = (
        spring(num_joints, stiffness=0.4, quadratic=0.7, damping=0.05, rest=0.1),
        JointLimits(**{name: torch.full((1, num_joints), value, dtype=F64) for name, value in ends.items()}),
    )
    gains = {"stiffness": 2.0, "damping": 0.1, "position": 0.3, "rate": 0.2, "effort": 0.01, "limit": 0.4}
    drive = Drive(**{name: torch.full((1, num_joints), value, dtype=F64) for name, value in gains.items()})
    bodies, actual, reference, at_limit = RolloutTrees(tree, 3, DT), first, first, []
    for _ in range(50):
        actual = implicit_euler(tree, links, laws, actual, DT, gravity=G, drive=drive, wrench=wrench)
        reference = bodies.move(tree, links, laws, reference, DT, gravity=G, drive=drive, wrench=wrench)
        at_limit.append(drive.effort_demand(actual.joint_pos, actual.joint_vel).abs() > drive.limit)
    assert 0.0 < torch.stack(at_limit).double().mean() < 1.0
    assert_same(actual, reference, bound=1e-9)


def test_a_link_without_mass_between_two_joints_moves_as_in_torch() -> None:
    """A universal joint; MuJoCo's link between them weighs 1e-9 kg, 1e-8 of the arm."""
    tree = random_tree(2, 3, chain=True)
    links, state = random_links(tree, 2, 3), random_motion(tree, 2, 3)
    mass, inertia = links.mass.clone(), links.inertia.clone()
    mass[:, 1], inertia[:, 1] = 0.0, 0.0
    links = Links(mass=mass, com=links.com, inertia=inertia)
    bodies, actual, reference = RolloutTrees(tree, 2, DT), state, state
    for _ in range(25):
        actual = implicit_euler(tree, links, (), actual, DT, gravity=G, wrench=no_wrench(tree, 2))
        reference = bodies.move(tree, links, (), reference, DT, gravity=G, wrench=no_wrench(tree, 2))
    assert_same(actual, reference, bound=1e-6)


def assert_bends_alone_as_in_a_batch(make_trees: Callable[[Tree, int, float], Any]) -> None:
    """Environment 2 of three, of which environment 1 is not finite and stays so."""
    tree, law = random_tree(4, 8), spring(4, stiffness=0.4, quadratic=0.7, damping=0.05)
    links, batch = random_links(tree, 3, 8), random_motion(tree, 3, 8)
    batch.joint_vel[1, 2] = torch.nan
    bodies, one = make_trees(tree, 3, DT), make_trees(tree, 1, DT)
    alone = TreeState(**{name: rows[2:] for name, rows in vars(batch).items()})
    weights = Links(**{name: rows[2:] for name, rows in vars(links).items()})
    for _ in range(20):
        batch = bodies.move(tree, links, (law,), batch, DT, gravity=G, wrench=no_wrench(tree, 3))
        alone = one.move(tree, weights, (law,), alone, DT, gravity=G, wrench=no_wrench(tree, 1))
    assert batch.position[1].isnan().all()
    for name, rows in vars(alone).items():
        assert torch.equal(rows[0], getattr(batch, name)[2]), name


def test_environments_bend_alone_as_in_a_batch_and_what_is_not_finite_stays_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MuJoCo is not told of what is not finite: it would write a file."""
    monkeypatch.chdir(tmp_path)
    assert_bends_alone_as_in_a_batch(RolloutTrees)
    assert not list(tmp_path.iterdir())


def test_a_step_of_another_length_is_refused() -> None:
    tree = random_tree(4, 8)
    links, state = random_links(tree, 3, 8), random_motion(tree, 3, 8)
    with pytest.raises(ShapeError, match="of another tree, or of steps of 0.002 s"):
        RolloutTrees(tree, 3, DT).move(tree, links, (), state, 0.01, gravity=G, wrench=no_wrench(tree, 3))


@pytest.mark.parametrize(
    "robot",
    frequent_values(
        (name for name in ROBOTS.names() if ROBOTS.get(name).joints is not None),
        ("morphy_creeping", "morphy_fixed_base", "snakey6", "tilt_tricopter"),  # drives, by test_trees
    ),
)
def test_every_robot_with_joints_flies_as_on_torch(robot: str) -> None:
    flies_as_on_torch(robot, "mujoco")


def flies_as_on_torch(robot: str, other: str) -> None:
    sims = []
    for backend in ("torch", other):
        sim = SimBuilder().build_env(
            sim_name="base_sim", env_name="empty_env", robot_name=robot, controller_name="no_control", num_envs=3,
            device="cpu", seed=2, backend=backend,
        )  # fmt: skip
        sim.reset()
        if "fixed" in robot:
            sim.gtd["robot_linvel"].zero_()
            sim.gtd["robot_body_angvel"].zero_()
        for _ in range(30):
            sim.step(torch.full_like(sim.gtd["robot_actions"], 0.4))
        sims.append(sim)
    for key in (
        "robot_position",
        "robot_orientation",
        "robot_linvel",
        "robot_body_angvel",
        "dof_position",
        "dof_velocity",
    ):
        one, other = (sim.gtd[key] for sim in sims)
        assert (one - other).abs().max() <= 1e-4 * (1.0 + one.abs().max()), key


def test_mujoco_warp_refuses_contact_of_links_by_name() -> None:
    with pytest.raises(
        CapabilityError,
        match="mujoco_warp: cannot push back at a contact of a vehicle with joints. Use backend 'mujoco'",
    ):
        SimBuilder().build_env(
            sim_name="base_sim", env_name="landing_env", robot_name="morphy", controller_name="no_control", num_envs=1,
            device="cpu", backend="mujoco_warp",
        )  # fmt: skip


SPAN, PROBE = 0.05, 1e-6

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
