"""Ten seconds of trees as large as the robots on which another solver diverges: none diverges. Newton's Featherstone
solver gives NaN within 0.3 s on serial arms of 6 joints (so100, so101, z1) and on humanoids of 19 and 23 (h1, g1) that
nothing drives or touches (newton-physics/newton issue 4269). Their files are not here: trees of that size are drawn,
with links of 0.1 to 1 kg in any direction, and fly in the fused kernel, in float32, in steps of 2 ms."""

from dataclasses import replace
from typing import Any

import pytest
import torch

from aerial_gym.config.joint import JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.math.random import Randomness
from aerial_gym.physics import WarpBackend, build_model, vehicle_from_config
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.motion import place_links
from aerial_gym.physics.state import ArticulatedState, state_at_rest
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.trees import random_links, random_tree

NUM_ENVS, DT, SECONDS = 64, 0.002, 10.0


def random_robot(num_joints: int, seed: int, *, floating: bool, chain: bool, damping: float) -> RobotCfg:
    """Return a tree whose reference pose is that of zero coordinates, on the mounts of another robot, which do not push."""
    tree = random_tree(num_joints, seed, floating=floating, chain=chain)
    links = random_links(tree, 1, seed)
    places = place_links(tree, links, torch.zeros(1, num_joints, dtype=torch.float64))

    def numbers(values: torch.Tensor) -> Any:
        return tuple(tuple(row) for row in values.tolist()) if values.dim() > 1 else tuple(values.tolist())

    names = ["base", *(f"joint_{k}" for k in range(num_joints))]
    layout = tuple(
        JointCfg(
            name=names[k + 1], parent=names[joint.parent], kind=joint.kind, axis=numbers(places.axis[0, k]),
            position=numbers(places.origin[0, k + 1]), spring=SpringCfg(damping=damping) if damping else None,
            link=LinkCfg(
                mass=float(links.mass[0, k + 1]), com=numbers(places.com[0, k + 1]),
                inertia=numbers(0.5 * (places.inertia[0, k + 1] + places.inertia[0, k + 1].T)),
            ),
            initial=(-0.7, 0.7), initial_rate=(-2.0, 2.0),
        )
        for k, joint in enumerate(tree.joints)
    )  # fmt: skip
    mass = links.mass[0]
    com = mass @ places.com[0] / mass.sum()
    lever = places.com[0] - com
    whole = places.inertia[0].sum(0)
    whole = whole + (mass[:, None, None] * (lever.square().sum(-1)[:, None, None] * torch.eye(3).double())).sum(0)
    whole = whole - torch.einsum("l,la,lb->ab", mass, lever, lever)
    plain = ROBOTS.get("base_quadrotor")
    body = replace(plain.body, mass=float(mass.sum()), com=numbers(com), inertia=numbers(0.5 * (whole + whole.T)))
    return replace(plain, body=body, joints=JointsCfg(layout=layout, floating=floating, source="drawn"))


@pytest.mark.slow
@pytest.mark.parametrize("damping", [0.0, 0.05])
@pytest.mark.parametrize(
    ("num_joints", "floating", "chain"), [(6, False, True), (6, True, True), (19, True, False), (23, True, False)]
)
def test_ten_seconds_without_divergence(num_joints: int, floating: bool, chain: bool, damping: float) -> None:
    """Finite in every environment at every tenth of a second, and rates below 1e3 rad/s (or m/s)."""
    robot = random_robot(num_joints, num_joints, floating=floating, chain=chain, damping=damping)
    vehicle = vehicle_from_config(robot, num_envs=NUM_ENVS)
    articulation = build_articulation(robot, like=vehicle.mass)
    law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81, dt=DT)
    backend = WarpBackend()
    model = build_model(vehicle, articulation=articulation)
    backend.allocate(model, law, integrator="euler", random=Randomness(NUM_ENVS))
    gen = torch.Generator().manual_seed(1)
    start = state_at_rest(NUM_ENVS, vehicle.num_rotors, device=torch.device("cpu"), dtype=torch.float32)
    drawn = [torch.rand(NUM_ENVS, num_joints, generator=gen) for _ in range(2)]
    state = ArticulatedState(**vars(start), joint_pos=1.4 * drawn[0] - 0.7, joint_vel=4.0 * drawn[1] - 2.0)
    action, largest = torch.zeros(NUM_ENVS, len(law.action_names)), 0.0
    for _ in range(round(10 * SECONDS)):
        backend.step(state, action, DT, round(0.1 / DT))
        assert all(tensor.isfinite().all() for tensor in state.tensors())
        largest = max(largest, float(state.joint_vel.abs().max()))
    print(f"{num_joints} joints, {'floating' if floating else 'fixed'}, damping {damping}: rates up to {largest:.3g}")
    assert largest < 1e3
