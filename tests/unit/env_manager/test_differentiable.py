"""Gradients through whole simulations: from actions, over several steps, to the states."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import ROBOTS, EnvManager, SimBuilder
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.errors import CapabilityError, ConfigError
from tests.physics.rotor_types import three_type_robot

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
    with pytest.raises(CapabilityError, match="backend warp: cannot .*. Use backend 'torch'"):
        build(backend="warp")
    with pytest.raises(ConfigError, match="the GTD is float32. Give differentiable=True"):
        build(differentiable=False)
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
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


def test_drawn_gains_never_overwrite_a_graph_in_silence() -> None:
    drawn = {"gains.rate": RandomizeCfg(low=0.8, high=1.2)}
    env = build(robot_name=replace(ROBOTS.get("base_quadrotor"), randomize=drawn))
    for _ in range(2):
        env.step(torch.full((NUM_ENVS, 4), 0.1, dtype=F64, requires_grad=True))
    loss = env.gradient_tensors["robot_body_angvel"][1].sum()
    env.reset(torch.tensor([True, False]))
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()


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
