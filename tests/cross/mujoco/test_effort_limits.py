"""Drives with limits and dry friction beside MuJoCo's own, and on backend ``mujoco``. The MJCF is written here: MuJoCo
itself clamps its actuators (``forcerange``) and solves for dry friction (``frictionloss``), in steps so short that its
explicit actuators follow. No function of this package has a part in it. Letters: E environments, D joints."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.mujoco.rollouts import RolloutTrees
from aerial_gym.physics.mujoco.trees import MujocoTrees
from tests.physics.articulated.effort_rig import (
    DT,
    StepRecorder,
    TreeCase,
    fly,
    random_bent,
    random_snakes,
    worst_residuals,
)
from tests.repetitions import frequent_values

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")

LIMIT = 1e-5
"""Share of its limit by which an effort may be off."""

FINE = 12.5e-6
"""Step of MuJoCo [s]."""


def engine(bent: TreeCase):
    """Return the step of backend ``mujoco`` for a tree."""
    return RolloutTrees(bent.tree, len(bent.state.position), DT).move


@pytest.mark.parametrize("count", frequent_values([8, 200], [8]))
def test_trees_keep_their_limits_on_the_backend(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    watched = StepRecorder(monkeypatch, MujocoTrees, "_step")
    worst = worst_residuals([random_bent(seed) for seed in range(count)], watched, 5, engine)
    print(f"\n{count} trees: {worst}")
    assert worst.worst <= LIMIT


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [f"snakey{rods}{mode}" for rods in ("", "5", "6") for mode in ("", "_position", "_effort")]
)
def test_snakes_keep_their_limits_on_the_backend(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    watched = StepRecorder(monkeypatch, MujocoTrees, "_step")
    worst = worst_residuals([random_snakes(name, friction=0.05)], watched, 50, engine)
    print(f"\n{name}: {worst}")
    assert worst.worst <= LIMIT


def numbers(values: object) -> str:
    return " ".join(f"{float(x):.17g}" for x in values)


def write_tree(bent: TreeCase, env: int) -> str:
    """Return the tree of one environment as MuJoCo reads it, with a drive and dry friction in each joint that has them."""
    bodies: list[list[str]] = [[] for _ in range(bent.tree.num_links)]
    actuators = []
    for link in reversed(range(bent.tree.num_links)):
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = bent.links.inertia[env, link].tolist()
        inertial = (
            f'<inertial mass="{bent.links.mass[env, link]:.17g}" pos="{numbers(bent.links.com[env, link])}" '
            f'fullinertia="{numbers((xx, yy, zz, xy, xz, yz))}"/>'
        )
        place, joint = "", '<freejoint name="base"/>' if bent.tree.floating else ""
        if link:
            k, kind = link - 1, {"revolute": "hinge", "prismatic": "slide"}
            of = bent.tree.joints[k]
            x, y, z, w = of.attitude
            place = f'pos="{numbers(of.position)}" quat="{numbers((w, x, y, z))}"'
            loss = float(bent.friction.limit[0, k])
            joint = f'<joint name="j{k}" type="{kind[of.kind]}" axis="{numbers(of.axis)}" frictionloss="{loss:.17g}"/>'
            stiffness, damping, limit = (
                float(part[0, k]) for part in (bent.drive.stiffness, bent.drive.damping, bent.drive.limit)
            )
            asked = (
                stiffness * bent.drive.position[env, k] + damping * bent.drive.rate[env, k] + bent.drive.effort[env, k]
            )
            if stiffness > 0.0:
                actuators.insert(0,
                    f'<general joint="j{k}" biastype="affine" gainprm="1" biasprm="{asked:.17g} {-stiffness:.17g} '
                    f'{-damping:.17g}" forcelimited="true" forcerange="{-limit:.17g} {limit:.17g}"/>'
                )  # fmt: skip
        text = f'<body name="l{link}" {place}>{joint}{inertial}{"".join(bodies[link])}</body>'
        if link:
            bodies[bent.tree.joints[link - 1].parent].insert(0, text)
    solver = f'solreffriction="{2.0 * FINE:.17g} 1" solimpfriction="0.9999 0.9999 0.001 0.5 2"'
    world = text.replace('frictionloss="', f'{solver} frictionloss="')
    return (
        f'<mujoco><compiler boundmass="0" boundinertia="0"/><option timestep="{FINE:.17g}" gravity="0 0 -9.81" '
        f'tolerance="1e-14" iterations="50"><flag contact="disable"/></option><worldbody>{world}</worldbody>'
        f"<actuator>{''.join(actuators)}</actuator></mujoco>"
    )


def fly_mujoco(bent: TreeCase, env: int, span: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rates of joints after a time [s], the wrenches of the links held in their axes."""
    model = mujoco.MjModel.from_xml_string(write_tree(bent, env))
    data, state = mujoco.MjData(model), bent.state
    assert [model.joint(f"j{k}").qposadr[0] for k in range(bent.tree.num_joints)]
    if bent.tree.floating:
        x, y, z, w = state.attitude[env].tolist()
        data.qpos[:7] = [*state.position[env].tolist(), w, x, y, z]
        data.qvel[:6] = [*state.lin_vel[env].tolist(), *state.ang_vel[env].tolist()]
    places = [int(model.joint(f"j{k}").qposadr[0]) for k in range(bent.tree.num_joints)]
    rates = [int(model.joint(f"j{k}").dofadr[0]) for k in range(bent.tree.num_joints)]
    data.qpos[places], data.qvel[rates] = state.joint_pos[env].numpy(), state.joint_vel[env].numpy()
    for _ in range(round(span / FINE)):
        mujoco.mj_step(model, data)
    return data.qpos[places].copy(), data.qvel[rates].copy()


def without_wrench(seed: int) -> TreeCase:
    """Return a tree of up to five joints without forces on links; a base on a stand stands level, as that of the MJCF."""
    bent = random_bent(seed, num_envs=2, largest=5)
    if not bent.tree.floating:
        level = torch.zeros_like(bent.state.attitude)
        level[:, 3] = 1.0
        bent = replace(bent, state=replace(bent.state, attitude=level))
    return replace(bent, wrench=torch.zeros_like(bent.wrench))


def off(bent: TreeCase, state: TreeState, exact: list[tuple[np.ndarray, np.ndarray]]) -> Tensor:
    places = torch.tensor(np.stack([place for place, _ in exact]))
    return (state.joint_pos - places).abs()


@pytest.mark.parametrize("seeds", frequent_values([range(1, 6), range(200)], [range(1, 6)]))
def test_joints_move_as_by_an_mjcf_of_its_own(seeds: range) -> None:
    """0.02 s: errors against MuJoCo fall with the step, to order 1 over all trees; what is left is MuJoCo's soft friction."""
    span, errors = 0.02, {dt: [] for dt in (2e-3, 1e-3, 5e-4)}
    for seed in seeds:
        bent = without_wrench(seed)
        exact = [fly_mujoco(bent, env, span) for env in range(2)]
        for dt, result in errors.items():
            result.append(off(bent, fly(bent, round(span / dt), dt=dt, stepper=implicit_euler).state, exact).flatten())
    medians = [torch.cat(result).square().mean().sqrt().item() for result in errors.values()]
    print(f"\noff by {medians} at 2, 1 and 0.5 ms")
    orders = [np.log2(a / b) for a, b in itertools.pairwise(medians)]
    assert np.mean(orders) == pytest.approx(1.0, abs=0.2)
