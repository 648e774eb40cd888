"""Gradients through whole simulations: from actions, over several steps, to the states.
Gradients through simulations of vehicles that bend: from actions, over several steps, to joints and base.
"""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import ENVIRONMENTS, ROBOTS, EnvManager, SimBuilder
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError, ConfigError
from tests.builders import simulation
from tests.physics.rotor_types import three_type_robot
from tests.refusals import assert_refused

F64 = torch.float64
STEPS, NUM_ENVS = 3, 2


def build(controller: str = "lee_attitude_control", **options) -> EnvManager:
    chosen = {"env_name": "empty_env", "robot_name": "base_quadrotor", "dtype": F64, "differentiable": True, **options}
    fixed = {"sim_name": "base_sim", "num_envs": NUM_ENVS, "device": "cpu", "seed": 3}
    env = SimBuilder().build_env(controller_name=controller, **fixed, **chosen)
    env.reset()
    return env


def make_objective(env: EnvManager) -> Callable[[Tensor], Tensor]:
    """Return a function from actions (T, E, U) to a number that depends on all states of a flight from the same start."""

    def loss(actions: Tensor) -> Tensor:
        env.restart(3)
        env.reset()
        total = actions.new_zeros(())
        for action in actions:
            env.step(action)
            for i, rows in enumerate(env.gradient_tensors.values()):
                rows = rows.flatten(1)
                total = total + (rows * torch.arange(1.0 + i, rows.shape[1] + 1.0 + i, dtype=rows.dtype).cos()).sum()
        return total

    return loss


@pytest.mark.parametrize(("controller", "size"), [("lee_attitude_control", 0.1), ("no_control", 0.6)])
def test_gradients_of_a_flight_are_its_differences(controller: str, size: float) -> None:
    actions = size * torch.rand(STEPS, NUM_ENVS, 4, dtype=F64, generator=torch.Generator().manual_seed(1))
    objective = make_objective(build(controller))
    assert torch.autograd.gradcheck(objective, (actions.requires_grad_(),), atol=1e-6, rtol=1e-5)


def flight_gradient(env: EnvManager) -> Tensor:
    """Return the gradient of a flight that saturates rotors, touches nothing, and is the same in every float type."""
    dtype = env.gradient_tensors["robot_position"].dtype
    actions = 0.8 * torch.rand(STEPS, NUM_ENVS, 4, generator=torch.Generator().manual_seed(1)).to(dtype) - 0.4
    (result,) = torch.autograd.grad(make_objective(env)(actions.requires_grad_()), actions)
    return result.double()


@pytest.mark.parametrize("robot", [pytest.param("base_quadrotor", marks=pytest.mark.slow), "mixed"])
def test_kernels_have_the_gradients_of_torch_operations(robot: str) -> None:
    """A step in float32 is two kernels, forward and back; in float64 it is torch's own operations, held to differences
    above. 1e-4 of the largest entry: some thousand operations in float32, whose results pass through the root of small
    thrusts."""
    chosen = {"robot_name": three_type_robot()} if robot == "mixed" else {}
    controller = "no_control" if robot == "mixed" else "lee_attitude_control"
    single, exact = (build(controller, dtype=dtype, **chosen) for dtype in (torch.float32, F64))
    result, expected = flight_gradient(single), flight_gradient(exact)
    torch.testing.assert_close(result, expected, atol=1e-4 * float(expected.abs().max()), rtol=0.0)
    for env, in_kernels in ((single, True), (exact, False)):
        backend = env.robot_manager.differentiable
        assert (backend._substep_kernel(0.01) is not None) == in_kernels


def test_what_remembers_runs_as_torch_operations() -> None:
    robot = replace(ROBOTS.get("base_quadrotor"), effects={"actuation_delay": {"delay": 0.01}})
    single, exact = (build(dtype=dtype, robot_name=robot) for dtype in (torch.float32, F64))
    result, expected = flight_gradient(single), flight_gradient(exact)
    torch.testing.assert_close(result, expected, atol=1e-4 * float(expected.abs().max()), rtol=0.0)
    assert single.robot_manager.differentiable._substep_kernel(0.01) is None


def test_obstacles_are_met_as_without_gradients() -> None:
    traced = build("lee_velocity_control", env_name="env_with_obstacles")
    fused = build("lee_velocity_control", env_name="env_with_obstacles", differentiable=False, dtype=torch.float32)
    for _ in range(5):
        for env in (traced, fused):
            env.step(torch.full((NUM_ENVS, 4), 0.5))
    torch.testing.assert_close(traced.gtd["robot_clearance"], fused.gtd["robot_clearance"], atol=1e-5, rtol=1e-5)
    assert torch.equal(traced.gtd["crashes"], fused.gtd["crashes"])


def test_what_has_no_gradient_is_refused_by_name() -> None:
    assert_refused(CapabilityError, "backend warp: cannot .*. Use backend 'torch'", build, backend="warp")
    assert_refused(ConfigError, "the GTD is float32. Give differentiable=True", build, differentiable=False)
    with pytest.raises(ConfigError, match="build it with differentiable=True"):
        _ = build(differentiable=False, dtype=torch.float32).gradient_tensors


def test_drawn_parameters_are_flown_and_never_overwrite_a_graph_in_silence() -> None:
    drawn = {"body.mass": RandomizeCfg(low=0.8, high=1.2)}
    drawn["rotor.thrust_map"] = RandomizeCfg(low=0.9, high=1.1, each_rotor=True)
    env = build(robot_name=replace(ROBOTS.get("base_quadrotor"), randomize=drawn))
    action = torch.full((NUM_ENVS, 4), 0.1, dtype=F64, requires_grad=True)
    env.step(action)
    loss = env.gradient_tensors["robot_linvel"].sum()
    loss.backward(retain_graph=True)
    assert action.grad[0, 0] != action.grad[1, 0]
    env.reset(torch.tensor([True, False]))
    assert_refused(RuntimeError, "modified by an inplace operation", loss.backward)


def test_drawn_gains_never_overwrite_a_graph_in_silence() -> None:
    drawn = {"gains.rate": RandomizeCfg(low=0.8, high=1.2)}
    env = build(robot_name=replace(ROBOTS.get("base_quadrotor"), randomize=drawn))
    for _ in range(2):
        env.step(torch.full((NUM_ENVS, 4), 0.1, dtype=F64, requires_grad=True))
    loss = env.gradient_tensors["robot_body_angvel"][1].sum()
    env.reset(torch.tensor([True, False]))
    assert_refused(RuntimeError, "modified by an inplace operation", loss.backward)


def test_a_plain_robot_has_no_slew_rate_to_draw() -> None:
    drawn = {"rotor.slew_rate": RandomizeCfg(low=0.8, high=1.2)}
    with pytest.raises(ConfigError, match=r"randomize: rotor.slew_rate: the rotors of this robot have none"):
        build(robot_name=replace(ROBOTS.get("base_quadrotor"), randomize=drawn))


def test_slew_rates_of_mixed_rotors_are_drawn_both_ways() -> None:
    """On the fused backend: thrust of the rotor in force mode climbs 60 N/s times the draw, and falls 90 N/s times it."""
    robot = replace(three_type_robot(), randomize={"rotor.slew_rate": RandomizeCfg(low=0.5, high=0.9, each_rotor=True)})
    env = build("no_control", robot_name=robot, differentiable=False, dtype=torch.float32)
    factor, thrust = env.robot_manager.draws()["rotor.slew_rate"][:, 2], env.gtd["rotor_speed"]
    before = thrust[:, 2].clone()
    env.step(torch.full((NUM_ENVS, 4), 6.0))
    torch.testing.assert_close(thrust[:, 2] - before, 60.0 * env.dt * factor)
    before = thrust[:, 2].clone()
    env.step(torch.zeros(NUM_ENVS, 4))
    torch.testing.assert_close(before - thrust[:, 2], 90.0 * env.dt * factor)


def test_resets_one_after_the_other_cut_each_their_own_rows() -> None:
    env, action = build(), torch.full((NUM_ENVS, 4), 0.1, dtype=F64, requires_grad=True)
    env.step(action)
    env.reset(torch.tensor([True, False]))
    reached = env.gradient_tensors["robot_linvel"].sum()
    env.reset(torch.tensor([False, True]))
    env.random.mask.data.fill_(True)  # as a kernel does, of which torch knows nothing
    (gradient,) = torch.autograd.grad(reached, action)
    assert gradient[0].tolist() == [0.0] * 4
    assert gradient[1].abs().max() > 0.0


def test_actions_are_traced_beside_the_motion() -> None:
    env = build()
    first, second = (torch.full((NUM_ENVS, 4), u, dtype=F64, requires_grad=True) for u in (0.1, 0.2))
    env.step(first)
    env.step(second)
    torch.autograd.grad(env.gradient_tensors["robot_actions"].sum(), second)
    torch.autograd.grad(env.gradient_tensors["robot_prev_actions"].sum(), first)
    for key in ("robot_actions", "robot_prev_actions"):
        torch.testing.assert_close(env.gtd[key].double(), env.gradient_tensors[key].detach(), atol=1e-7, rtol=0.0)
    env.reset(torch.tensor([True, False]))
    assert env.gradient_tensors["robot_actions"].tolist() == [[0.0] * 4, [0.2] * 4]
    assert env.gradient_tensors["robot_prev_actions"].tolist() == [[0.0] * 4, [0.1] * 4]


def test_a_reset_leaves_what_effects_of_other_rows_remember_in_the_graph() -> None:
    """Of commands that are 30 ms late: what row 1 did before a reset of row 0 counts as it does without that reset."""
    late = replace(ROBOTS.get("base_quadrotor"), effects={"actuation_delay": {"delay": 0.03}})
    gradients = []
    for mask in ([False, False], [True, False]):
        env = build("no_control", robot_name=late)
        first, later = (torch.full((NUM_ENVS, 4), u, dtype=F64, requires_grad=True) for u in (0.1, 0.3))
        env.step(first)
        env.reset(torch.tensor(mask))
        for _ in range(5):
            env.step(later)
        gradients.append(torch.autograd.grad(env.gradient_tensors["rotor_speed"].sum(), first)[0])
    assert gradients[0][1].abs().max() > 0.0
    assert torch.equal(gradients[0][1], gradients[1][1])
    assert gradients[1][0].tolist() == [0.0] * 4


DRAG = {"link_drag": {"qx": 0.02, "qy": 0.02, "qz": 0.04, "lx": 0.01, "az": 1e-4}}
DRAG |= {"constant_wind": {"x": 2.0, "y": 0.5, "z": 0.0}}
JOINTS = ("dof_position", "dof_velocity", "dof_state_tensor")


def build_jointed(robot: RobotCfg | str, **options) -> EnvManager:
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
def test_gradients_of_a_flight_with_joints_are_its_differences(robot: RobotCfg, low: float, high: float) -> None:
    """Of every state in every step with respect to every action before it, to the accuracy of central differences.
    Joints begin beyond their ends, and drives come to their limits in some steps."""
    env = build_jointed(robot)
    actions = make_actions(env, low, high).requires_grad_()
    assert torch.autograd.gradcheck(make_objective(env), (actions,), atol=1e-6, rtol=1e-5, fast_mode=True)


def test_the_dictionary_shows_what_is_traced() -> None:
    env = build_jointed("morphy")
    for _ in range(2):
        env.step(torch.full((NUM_ENVS, 4), 0.8, dtype=F64).requires_grad_())
    assert set(JOINTS) < set(env.gradient_tensors)
    for key, rows in env.gradient_tensors.items():
        assert rows.requires_grad or key == "robot_vehicle_orientation"
        assert not env.gtd[key].requires_grad
        torch.testing.assert_close(env.gtd[key].double(), rows.detach(), atol=2e-6, rtol=2e-6)


def test_a_rigid_vehicle_has_no_joints_to_trace() -> None:
    assert not set(JOINTS) & set(build_jointed("morphy_stiff").gradient_tensors)


@pytest.mark.parametrize("robot", ["morphy_creeping", "snakey"])
def test_a_flight_with_gradients_is_the_plain_flight(robot: str) -> None:
    traced, fused = build_jointed(robot), build_jointed(robot, differentiable=False, dtype=torch.float32)
    for step in range(8):
        for env in (traced, fused):
            env.step(torch.full((NUM_ENVS, env.robot_manager.num_actions), 0.7))
            if step == 4:
                env.reset(torch.tensor([True, False]))
    for key in ("robot_position", "robot_body_angvel", *JOINTS):
        torch.testing.assert_close(traced.gtd[key], fused.gtd[key], atol=2e-5, rtol=2e-5)


def test_a_reset_cuts_its_own_rows_and_detach_all() -> None:
    env = build_jointed("morphy_creeping")
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
    for cut in (env.detach, env.detach_in_place, env.reset):
        env.step(later)
        assert env.gradient_tensors["dof_position"].requires_grad
        cut()
        assert not env.gradient_tensors["dof_position"].requires_grad
        assert not backend._crept.requires_grad


def test_what_a_recorded_window_begins_with_stays_in_its_place() -> None:
    env, places = build_jointed("morphy_creeping"), []
    for _ in range(3):
        env.step(torch.full((NUM_ENVS, 4), 0.8, dtype=F64, requires_grad=True))
        before = {key: env.gradient_tensors[key].detach().clone() for key in JOINTS[:2]}
        env.detach_in_place()
        for key, rows in before.items():
            assert torch.equal(env.gradient_tensors[key], rows)
        crept = env.robot_manager.backend.state_tensors()["crept"]
        places.append([crept.data_ptr(), *(env.gradient_tensors[key].data_ptr() for key in JOINTS[:2])])
    assert places[0] == places[1] == places[2]


def test_a_saved_flight_goes_on_as_if_it_had_not_stopped() -> None:
    one, other = build_jointed("morphy_creeping"), build_jointed("morphy_creeping")
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
    traced, fused = build_jointed(robot), build_jointed(robot, differentiable=False, dtype=torch.float32)
    for _ in range(6):
        for env in (traced, fused):
            env.step(torch.full((NUM_ENVS, 10), 1.5))
        torch.testing.assert_close(*(e.gtd["robot_link_clearance"] for e in (traced, fused)), atol=1e-5, rtol=1e-5)
        assert torch.equal(traced.gtd["crashes"], fused.gtd["crashes"])
        crashed |= traced.gtd["crashes"]
    assert crashed.any()
