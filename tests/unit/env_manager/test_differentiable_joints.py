"""Gradients through simulations of vehicles that bend: from actions, over several steps, to joints and base."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager
from aerial_gym.config.robot import RobotCfg
from tests.builders import simulation
from tests.unit.env_manager.test_differentiable import make_objective

F64 = torch.float64
STEPS, NUM_ENVS = 3, 2
DRAG = {"link_drag": {"qx": 0.02, "qy": 0.02, "qz": 0.04, "lx": 0.01, "az": 1e-4}}
DRAG |= {"constant_wind": {"x": 2.0, "y": 0.5, "z": 0.0}}
JOINTS = ("dof_position", "dof_velocity", "dof_state_tensor")


def build(robot: RobotCfg | str, **options) -> EnvManager:
    """Return a simulation with gradients in float64, two substeps a step, reset."""
    defaults = {"dtype": F64, "differentiable": True, "num_envs": NUM_ENVS, "seed": 3}
    place = replace(ENVIRONMENTS.get("empty_env_2ms"), physics_steps_per_env_step=2)
    env = simulation(robot, sim="base_sim_2ms", env=place, **defaults | options)
    env.reset()
    return env


def bend(name: str, *, friction: float = 0.0, **changes: object) -> RobotCfg:
    """Return a robot whose joints begin up to 0.3 rad from their reference, with dry friction [N m] in their springs."""
    robot = ROBOTS.get(name)
    start = {"initial": (-0.3, 0.3), "initial_rate": (-2.0, 2.0)}
    layout = tuple(
        replace(joint, spring=None if joint.spring is None else replace(joint.spring, friction=friction), **start)
        for joint in robot.joints.layout
    )
    return replace(robot, joints=replace(robot.joints, layout=layout), **changes)


def make_actions(env: EnvManager, low: float, high: float) -> Tensor:
    shape, g = (STEPS, NUM_ENVS, env.robot_manager.num_actions), torch.Generator().manual_seed(1)
    return low + (high - low) * torch.rand(shape, dtype=F64, generator=g)


@pytest.mark.parametrize(("robot", "low", "high"), [
    pytest.param(bend("morphy", effects=DRAG), 0.2, 1.5, id="springs and ends"),
    pytest.param(bend("morphy_fixed_base", effects=DRAG), 0.2, 1.5, id="on a stand"),
    pytest.param(bend("snakey", effects=DRAG), -0.9, 0.9, id="driven to rates"),
    pytest.param(bend("morphy_creeping", friction=0.05), 0.2, 1.5, id="creep and friction"),
])  # fmt: skip
def test_gradients_of_a_flight_are_its_differences(robot: RobotCfg, low: float, high: float) -> None:
    """Of every state in every step with respect to every action before it, to the accuracy of central differences.
    Joints begin beyond their ends, and drives come to their limits in some steps."""
    env = build(robot)
    actions = make_actions(env, low, high).requires_grad_()
    assert torch.autograd.gradcheck(make_objective(env), (actions,), atol=1e-6, rtol=1e-5, fast_mode=True)


def test_the_dictionary_shows_what_is_traced() -> None:
    env = build("morphy")
    for _ in range(2):
        env.step(torch.full((NUM_ENVS, 4), 0.8, dtype=F64).requires_grad_())
    assert set(JOINTS) < set(env.gradient_tensors)
    for key, rows in env.gradient_tensors.items():
        assert rows.requires_grad or key == "robot_vehicle_orientation"
        assert not env.gtd[key].requires_grad
        torch.testing.assert_close(env.gtd[key].double(), rows.detach(), atol=2e-6, rtol=2e-6)


def test_a_rigid_vehicle_has_no_joints_to_trace() -> None:
    assert not set(JOINTS) & set(build("morphy_stiff").gradient_tensors)


@pytest.mark.parametrize("robot", ["morphy_creeping", "snakey"])
def test_a_flight_with_gradients_is_the_plain_flight(robot: str) -> None:
    traced, fused = build(robot), build(robot, differentiable=False, dtype=torch.float32)
    for step in range(8):
        for env in (traced, fused):
            env.step(torch.full((NUM_ENVS, env.robot_manager.num_actions), 0.7))
            if step == 4:
                env.reset(torch.tensor([True, False]))
    for key in ("robot_position", "robot_body_angvel", *JOINTS):
        torch.testing.assert_close(traced.gtd[key], fused.gtd[key], atol=2e-5, rtol=2e-5)


def test_a_reset_cuts_its_own_rows_and_detach_all() -> None:
    env = build("morphy_creeping")
    first, later = (torch.full((NUM_ENVS, 4), u, dtype=F64, requires_grad=True) for u in (0.5, 0.8))
    env.step(first)
    env.reset(torch.tensor([True, False]))
    for key in ("dof_position", "dof_velocity"):
        torch.testing.assert_close(env.gradient_tensors[key].float(), env.gtd[key], atol=0.0, rtol=0.0)
        (gradient,) = torch.autograd.grad(env.gradient_tensors[key].sum(), first, retain_graph=True)
        assert gradient[0].tolist() == [0.0] * 4
        assert gradient[1].abs().max() > 0.0
    env.step(later)
    backend = env.robot_manager.differentiable
    (gradient,) = torch.autograd.grad(backend._crept.sum(), first)
    assert gradient[0].tolist() == [0.0] * 4
    assert gradient[1].abs().max() > 0.0
    for cut in (env.detach, env.settle, env.reset):
        env.step(later)
        assert env.gradient_tensors["dof_position"].requires_grad
        cut()
        assert not env.gradient_tensors["dof_position"].requires_grad
        assert not backend._crept.requires_grad


def test_what_a_recorded_window_begins_with_stays_in_its_place() -> None:
    env, places = build("morphy_creeping"), []
    for _ in range(3):
        env.step(torch.full((NUM_ENVS, 4), 0.8, dtype=F64, requires_grad=True))
        before = {key: env.gradient_tensors[key].detach().clone() for key in JOINTS[:2]}
        env.settle()
        for key, rows in before.items():
            assert torch.equal(env.gradient_tensors[key], rows)
        crept = env.robot_manager.backend.state_tensors()["crept"]
        places.append([crept.data_ptr(), *(env.gradient_tensors[key].data_ptr() for key in JOINTS[:2])])
    assert places[0] == places[1] == places[2]


def test_a_saved_flight_goes_on_as_if_it_had_not_stopped() -> None:
    one, other = build("morphy_creeping"), build("morphy_creeping")
    for env, thrust in ((one, 0.9), (other, 0.3)):
        for _ in range(3):
            env.step(torch.full((NUM_ENVS, 4), thrust, dtype=F64, requires_grad=True))
    other.load_state(one.save_state())
    for _ in range(3):
        for env in (one, other):
            env.step(torch.full((NUM_ENVS, 4), 0.6))
    for key in ("robot_position", *JOINTS):
        assert torch.equal(one.gradient_tensors[key], other.gradient_tensors[key])


def test_links_that_collide_are_seen_as_without_gradients() -> None:
    snake = bend("snakey", collision=replace(ROBOTS.get("snakey").collision, between_links=True))
    layout = tuple(
        replace(joint, initial=(2.08, 2.08), initial_rate=(3.0, 3.0)) if joint.name.startswith("yaw") else joint
        for joint in snake.joints.layout
    )
    robot = replace(snake, joints=replace(snake.joints, layout=layout))
    crashed = torch.zeros(NUM_ENVS, dtype=torch.bool)
    traced, fused = build(robot), build(robot, differentiable=False, dtype=torch.float32)
    for _ in range(6):
        for env in (traced, fused):
            env.step(torch.full((NUM_ENVS, 10), 1.5))
        torch.testing.assert_close(*(e.gtd["robot_link_clearance"] for e in (traced, fused)), atol=1e-5, rtol=1e-5)
        assert torch.equal(traced.gtd["crashes"], fused.gtd["crashes"])
        crashed |= traced.gtd["crashes"]
    assert crashed.any()
