"""Buoyancy of links against closed forms, heights and the rigid engine; on other backends in ``tests/cross``."""

from dataclasses import replace

import torch
from torch import Tensor

from aerial_gym.config.joint import JointCfg, LinkCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.articulated.dynamics import equations_of_motion
from aerial_gym.physics.articulated.flight import link_wrenches
from aerial_gym.physics.articulated.tree import TreeState
from aerial_gym.physics.model import Model, build_model
from aerial_gym.physics.state import ArticulatedState
from aerial_gym.physics.vehicle import vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.articulated.lagrange import Energies, coordinates
from tests.physics.articulated.test_flight import at_rest, make_rod, throw
from tests.physics.articulated.test_link_drag import arm, make_drag_robot, make_model
from tests.physics.articulated.trees import F64

G = 9.81


def under_water(
    joints: tuple[JointCfg, ...], effects: dict[str, dict[str, float]], *, floating: bool = True
) -> RobotCfg:
    robot = make_drag_robot(1.0, joints, {})
    return replace(robot, effects=effects, joints=replace(robot.joints, floating=floating))


def link(mass: float, *com: float, inertia: tuple[float, float, float] = (1e-3, 2e-3, 2.5e-3)) -> LinkCfg:
    rows = tuple(tuple(inertia[i] if i == j else 0.0 for j in range(3)) for i in range(3))
    return LinkCfg(mass=mass, com=(com[0], com[1], com[2]), inertia=rows)


def tree_state(state: ArticulatedState) -> TreeState:
    return TreeState(**{name: rows for name, rows in vars(state).items() if name != "rotor_speed"})


def make_joints() -> tuple[JointCfg, ...]:
    """Return an arm of a hinge and a slide, and one more hinge."""
    return (
        arm("left", (0.1, 0.4, 0.05), (0.0, 0.1, 0.0), axis=(0.6, 0.0, 0.8), link=link(0.3, 0.1, 0.4, 0.05)),
        arm("slide", (0.2, 0.6, 0.0), (0.1, 0.5, 0.0), parent="left", kind="prismatic", axis=(0.0, 0.8, 0.6)),
        arm("right", (0.1, -0.4, 0.0), (0.0, -0.1, 0.0), axis=(1.0, 0.0, 0.0), link=link(0.2, 0.1, -0.4, 0.0)),
    )


def draw_state(state: ArticulatedState, seed: int = 4) -> ArticulatedState:
    gen = torch.Generator().manual_seed(seed)

    def draw(like: Tensor, scale: float) -> Tensor:
        return scale * torch.randn(like.shape, generator=gen, dtype=F64)

    return replace(
        state, position=draw(state.position, 1.0),
        attitude=torch.nn.functional.normalize(draw(state.attitude, 1.0), dim=-1), lin_vel=draw(state.lin_vel, 1.0),
        ang_vel=draw(state.ang_vel, 2.0), joint_pos=draw(state.joint_pos, 0.7), joint_vel=draw(state.joint_vel, 2.0),
    )  # fmt: skip


FORCES = {"force": 2.0, "x": 0.01, "left.force": 3.5, "left.y": -0.03, "left.z": 0.05, "base.z": 0.1, "base.force": 8.0}


def test_forces_along_coordinates_are_what_heights_of_centres_of_buoyancy_say() -> None:
    """``-dU/dx`` with ``U = -sum F z``, by SciPy's rotations; numbers of a link stand in place of those of all."""
    model, state = make_model(under_water(make_joints(), {"link_buoyancy": FORCES}), num_envs=3)
    state, articulation = draw_state(state), model.articulation
    tree, links, there = articulation.tree, articulation.links(model.vehicle), tree_state(state)
    wrench = link_wrenches(model, articulation, there, state.rotor_speed, state.rotor_speed)
    result = [equations_of_motion(tree, links, there, gravity=0.0, wrench=rows).force for rows in (wrench, None)]
    push, lever = torch.tensor([8.0, 3.5, 2.0, 2.0], dtype=F64).numpy(), torch.zeros(4, 3, dtype=F64).numpy()
    lever[:, 0], lever[1, 1], lever[1, 2], lever[0, 2] = 0.01, -0.03, 0.05, 0.1
    for env in range(3):
        expected = Energies.from_env(tree, links, there, env, push=push, lever=lever).forces(coordinates(there, env)[0])
        own = result[0] - result[1]
        world = torch.from_numpy(expected)
        turned = Energies.from_env(tree, links, there, env).attitude.as_matrix()
        world[:3] = torch.from_numpy(turned).T @ world[:3]
        torch.testing.assert_close(own[env], world, rtol=0.0, atol=1e-8)


def of_one_link(robot: RobotCfg, effects: list[tuple[object, Tensor]]) -> tuple[Model, ArticulatedState]:
    """Return a rigid robot as a tree of one link with effects on it, and a state in which it moves."""
    bending = build_articulation(ROBOTS.get("morphy"), like=torch.zeros(1, dtype=F64))
    vehicle = vehicle_from_config(robot, num_envs=3, dtype=F64)
    model = build_model(vehicle, effects, articulation=make_rod(bending))
    state = throw(at_rest(model))
    return model, replace(state, rotor_speed=torch.rand(3, 4, dtype=F64, generator=torch.Generator().manual_seed(1)))
