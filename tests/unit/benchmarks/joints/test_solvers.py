"""Both ways to solve for the accelerations of a tree in a kernel, against the torch reference.

Float32 torch is itself off the float64 result, so the bound is taken from it, as in ``tests/cross/test_joints.py``: a kernel
may be ``FACTOR`` times as far off as float32 torch is, plus a few units in the last place.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.config.joint import BASE, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.interop import start_warp
from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.physics.articulated.dynamics import equations, solve
from aerial_gym.physics.articulated.joint_laws import joint_effort
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.fused.packing import types_of
from aerial_gym.physics.model import Model
from aerial_gym.robots import ROBOTS
from benchmarks.joints.chains import DT, Chains, chain, stepping
from benchmarks.joints.solvers.again import (
    MAKERS,
    Motion,
    bends_of,
    joint_types,
    model_of,
    random_motion,
    solve_kernel,
    solve_launch,
)
from tests.repetitions import often

FACTOR, ROUND_OFF = 4.0, 4e-6

NUM_ENVS = 32


def random_robot(num_joints: int, seed: int, *, floating: bool) -> RobotCfg:
    """Return a body that carries a tree of joints of both kinds, one link without mass among them, and rotors on links."""
    rng, plain = np.random.default_rng(seed), ROBOTS.get("base_quadrotor")
    lump = ((4e-4, 1e-5, 0.0), (1e-5, 5e-4, 2e-5), (0.0, 2e-5, 6e-4))
    layout = []
    for k in range(num_joints):
        axis, place = rng.normal(size=3), rng.uniform(-0.2, 0.2, 3)
        parent = int(rng.integers(0, k + 1))
        layout.append(
            JointCfg(
                name=f"joint_{k}",
                parent=f"joint_{parent - 1}" if parent else BASE,
                kind="prismatic" if k % 4 == 1 else "revolute",
                axis=tuple((axis / np.linalg.norm(axis)).tolist()),
                position=tuple(place.tolist()),
                reference=0.1 * (k % 3),
                link=None if k == 0 else LinkCfg(mass=0.05, com=tuple((place + 0.05).tolist()), inertia=lump),
                spring=SpringCfg(stiffness=2.0, damping=0.02, rest=0.05),
            )
        )
    inertia = ((0.2, 0.0, 0.0), (0.0, 0.25, 0.0), (0.0, 0.0, 0.3))
    body = replace(plain.body, mass=1.0 + 0.05 * num_joints, inertia=inertia)
    first, second, *others = plain.mounts.layout
    on_links = (replace(first, link="joint_1"), replace(second, link=f"joint_{num_joints - 1}"), *others)
    joints = JointsCfg(layout=tuple(layout), floating=floating, source="test")
    return replace(plain, body=body, mounts=replace(plain.mounts, layout=on_links), joints=joints)


def reference(model: Model, motion: Motion, attitude: Tensor, dtype: torch.dtype) -> tuple[Tensor, Tensor, Tensor]:
    """Return the accelerations of ``Motion``, by ``dynamics``, in a float type."""

    def of(tensor: Tensor) -> Tensor:
        return tensor.to(dtype)

    vehicle, bends, turn = model.vehicle, bends_of(model).to(torch.zeros(1, dtype=dtype)), of(attitude)
    vehicle = replace(vehicle, **{name: of(rows) for name, rows in vehicle.rows().items()})
    lin_vel, ang_vel = of(motion.lin_vel), of(motion.ang_vel)
    back = torch.cat((-turn[:, :3], turn[:, 3:]), dim=1)
    state = TreeState(
        position=torch.zeros_like(lin_vel),
        attitude=turn,
        lin_vel=quat_rotate_inverse(back, lin_vel),
        ang_vel=ang_vel,
        joint_pos=of(motion.joint_pos),
        joint_vel=of(motion.joint_vel),
    )
    force = of(motion.thrust).unsqueeze(-1) * vehicle.rotor_axis
    drag = (vehicle.rotor_spin * of(motion.drag)).unsqueeze(-1) * vehicle.rotor_axis
    hub = (vehicle.rotor_position - bends.origins[list(bends.rotor_links)]).expand_as(force)
    each = torch.cat((force, torch.linalg.cross(hub, force) - drag), dim=-1)
    wrench = each.new_zeros(len(each), bends.tree.num_links, 6).index_add(1, torch.tensor(bends.rotor_links), each)
    acts = joint_effort(bends.laws(None), state.joint_pos, state.joint_vel)
    soft = acts.stiffness * DT
    found = equations(
        bends.tree, bends.links(vehicle), state, gravity=model.gravity, wrench=wrench,
        effort=acts.value - soft * state.joint_vel,
    )  # fmt: skip
    stiff = torch.diag_embed(torch.nn.functional.pad(DT * (acts.damping + soft), (6, 0)))
    now = solve(bends.tree, state, found.mass + stiff, found.force)
    rise = quat_rotate_inverse(turn, now.lin_acc) + of(motion.weight) - torch.linalg.cross(ang_vel, lin_vel)
    return rise, now.ang_acc, now.joint_acc


CASES = {
    "tree of 4": lambda: random_robot(4, 3, floating=True),
    "tree of 8 on a stand": lambda: random_robot(8, 4, floating=False),
    "star": lambda: ROBOTS.get("morphy"),
    "star on a stand": lambda: ROBOTS.get("morphy_fixed_base"),
    "chain of 2": lambda: chain(2),
    "chain of 3 on a stand": lambda: on_a_stand(chain(3)),
    "chain of 4": lambda: chain(4),
    "chain of 8": lambda: chain(8),
    "chain of 12": lambda: chain(12),
    "chain of 12 on a stand": lambda: on_a_stand(chain(12)),
    "tree of 12": lambda: random_robot(12, 5, floating=True),
}

ALWAYS = ("tree of 4", "chain of 3 on a stand")


def on_a_stand(robot: RobotCfg) -> RobotCfg:
    assert robot.joints is not None
    return replace(robot, joints=replace(robot.joints, floating=False))


@pytest.mark.parametrize("case", often(CASES, ALWAYS))
@pytest.mark.parametrize("way", MAKERS)
def test_accelerations_are_those_of_the_reference(way: str, case: str) -> None:
    start_warp()
    model = model_of(CASES[case](), NUM_ENVS, torch.device("cpu"))
    attitude = torch.nn.functional.normalize(
        torch.randn(NUM_ENVS, 4, generator=torch.Generator().manual_seed(1)), dim=-1
    )
    up = torch.tensor([0.0, 0.0, model.gravity]).expand(NUM_ENVS, 3)
    motion = replace(random_motion(model), weight=quat_rotate_inverse(attitude, up).contiguous())
    solve_launch(model, solve_kernel(model, way), motion, dt=DT, repeats=1).launch()
    exact = reference(model, motion, attitude, torch.float64)
    single = reference(model, motion, attitude, torch.float32)
    for right, rough, mine in zip(exact, single, (motion.lin_acc, motion.ang_acc, motion.joint_acc), strict=True):
        allowed = FACTOR * float((rough - right).abs().max()) + ROUND_OFF * float(right.abs().max())
        assert float((mine - right).abs().max()) <= allowed


def test_solves_in_one_launch_depend_on_each_other() -> None:
    """Two solves in a launch are one, and one from where the first leads; with base and weight at rest."""
    start_warp()
    model = model_of(on_a_stand(chain(2)), 3, torch.device("cpu"))
    first, both = random_motion(model), random_motion(model)
    kernel = solve_kernel(model, "recursion")
    solve_launch(model, kernel, both, dt=DT, repeats=2).launch()
    solve_launch(model, kernel, first, dt=DT, repeats=1).launch()
    rates = first.joint_vel + DT * first.joint_acc
    second = replace(first, joint_vel=rates, joint_pos=first.joint_pos + DT * rates)
    solve_launch(model, kernel, second, dt=DT, repeats=1).launch()
    torch.testing.assert_close(both.joint_acc, second.joint_acc, rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("acting", [({0: None}, {}), ({}, {0: None})])
def test_a_factor_refuses_what_the_air_does_to_links(acting: tuple[dict[int, None], dict[int, None]]) -> None:
    model = model_of(chain(2), 1, torch.device("cpu"))
    types = types_of(model)
    with pytest.raises(CapabilityError, match="no effects on links or at hubs"):
        MAKERS["factor"](bends_of(model), types, joint_types(2, None, types.vector), *acting)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["morphy", "snakey6_position"])
def test_steps_with_either_are_the_same(robot: str) -> None:
    """After 20 steps the rates of joints differ by round-off of what they have in common."""
    start_warp()
    asked = Chains(num_envs=2, substeps=20)
    ends = []
    for way in MAKERS:
        one = stepping("", ROBOTS.get(robot), way, asked, torch.device("cpu"))
        one.run()
        ends.append(one.found)
    torch.testing.assert_close(ends[0], ends[1], rtol=1e-3, atol=1e-3)


def test_device_is_asked_for_by_the_names_of_every_command() -> None:
    """``auto`` and ``cuda`` name a device by kind alone; a GPU that is not there is refused in a sentence."""
    with pytest.raises(ConfigError, match="auto, cpu, cuda or cuda:N"):
        Chains(device="graphics").run()
    Chains(device="auto", joints=(), robots=()).run()
