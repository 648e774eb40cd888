"""Gradients of rewards and observations with respect to actions, through resets, lines and filters."""

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ActionCfg, CommandCfg, ImageCfg, ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import CapabilityError
from tests.refusals import assert_refused
from tests.unit.task.hover import build_task

F64 = torch.float64
STEPS, NUM_ENVS = 5, 2
MOTION = ("robot_position", "robot_orientation", "robot_linvel", "robot_body_angvel", "rotor_speed")
MOTION += ("robot_actions", "robot_prev_actions")


def full_task() -> TaskCfg:
    """Return a task whose terms have noise, delays, history, scale, filter, and read actions and the step before."""
    return replace(
        task_registry.get("tracking_task"),
        episode_len_steps=4,
        action=ActionCfg(
            transform="affine",
            delay_steps=(0, 2),
            filter_time_s=0.02,
            params={"low": [-0.4, -0.5, -0.6, -0.7], "high": [0.5, 0.6, 0.7, 0.8]},
        ),
        observations={
            "policy": (
                ObservationCfg(term="position_error_body", noise_std=0.1, delay_steps=(0, 2), history=2, scale=3.0),
                ObservationCfg(term="rotation_rows"),
                ObservationCfg(term="last_action"),
                ObservationCfg(term="policy_action"),
                ObservationCfg(term="roll_pitch", delay_steps=1, dropout=0.3, dropout_value=2.0),
            ),
            "critic": (ObservationCfg(term="lin_vel_body"), ObservationCfg(term="ang_vel_body")),
        },
        rewards={
            "near": RewardCfg(term="distance_bell", params={"height": 3.0, "width": 0.3}),
            "together": RewardCfg(
                term="velocity_error_bell", params={"height": 1.0, "width": 0.2}, weight=0.7, times=("near",)
            ),
            "progress": RewardCfg(term="progress", params={"closer": 10.0, "further": 20.0}),
            "change": RewardCfg(term="action_change", params={"entry": 1, "height": 0.8, "width": 3.0}),
        },
        crash_reward=None,
        terminations={"lost": TerminationCfg(term="far_from_target", params={"distance": 5.0}, kind="crash")},
    )


def make_objective(task: Task) -> Callable[[Tensor], Tensor]:
    """Return a function from actions (T, E, V) to a number that depends on all that a task gives, from the same starts."""

    def weigh(tensor: Tensor, number: int) -> Tensor:
        weights = torch.arange(1.0 + number, 1.0 + number + tensor[0].numel(), dtype=tensor.dtype).cos()
        return (tensor.flatten(1) * weights).sum()

    def total(actions: Tensor) -> Tensor:
        task.reset(seed=3)
        task.env.gtd["sim_steps"].copy_(torch.arange(NUM_ENVS))  # rows end one after the other, each once at least
        result = actions.new_zeros(())
        for number, action in enumerate(actions):
            observation, reward, _, _, info = task.step(action)
            seen = (*observation.values(), info["final_observation"], reward.unsqueeze(-1))
            result = result + sum(weigh(each, number + i) for i, each in enumerate(seen))
        return result

    return total


SLOWLY = [pytest.param(name, marks=pytest.mark.slow) for name in ("position_setpoint_task", "tracking_task")]
"""Tasks whose terms are all in ``everything``."""


def test_gradients_of_rewards_and_observations_are_their_differences() -> None:
    """With episodes that end within the window, to the accuracy of central differences."""
    task = build_task(full_task(), NUM_ENVS, gradients=F64)
    actions = 0.4 * torch.rand(STEPS, NUM_ENVS, 4, dtype=F64, generator=torch.Generator().manual_seed(1))
    assert torch.autograd.gradcheck(make_objective(task), (actions.requires_grad_(),), atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("name", ["morphy", pytest.param("reconfigurable", marks=pytest.mark.slow)])
def test_gradients_of_a_task_with_joints_are_its_differences(name: str) -> None:
    cfg = replace(task_registry.get(f"position_setpoint_task_{name}"), episode_len_steps=3)
    task = build_task(cfg, NUM_ENVS, gradients=F64)
    actions = torch.rand(3, NUM_ENVS, task.num_actions, dtype=F64, generator=torch.Generator().manual_seed(1)) - 0.5
    check = {"atol": 1e-6, "rtol": 1e-5, "fast_mode": True}
    assert torch.autograd.gradcheck(make_objective(task), (actions.requires_grad_(),), **check)


@pytest.mark.parametrize("name", [*SLOWLY, "everything"])
def test_kernels_have_the_gradients_of_torch_operations(name: str) -> None:
    """In float32, by two kernels for each part of the step, against torch's own operations in float64, held to
    differences. 1e-4 of the largest entry: some thousand operations in float32."""
    cfg = full_task() if name == "everything" else replace(task_registry.get(name), episode_len_steps=4)
    single, exact = (build_task(cfg, NUM_ENVS, seed=3, gradients=dtype) for dtype in (torch.float32, F64))
    actions = 0.4 * torch.rand(STEPS, NUM_ENVS, 4, generator=torch.Generator().manual_seed(1))
    results = []
    for task, dtype in ((single, torch.float32), (exact, F64)):
        given = actions.to(dtype).requires_grad_()
        results.append(torch.autograd.grad(make_objective(task)(given), given)[0].double())
    torch.testing.assert_close(*results, atol=1e-4 * float(results[1].abs().max()), rtol=0.0)
    for task, in_kernels in ((single, True), (exact, False)):
        assert (task._judge.rows._kernels is not None) == in_kernels
        assert (task._observer.rows._kernels is not None) == in_kernels


@pytest.mark.parametrize("name", [*SLOWLY, "everything"])
def test_a_task_with_gradients_is_the_plain_task(name: str) -> None:
    cfg = full_task() if name == "everything" else replace(task_registry.get(name), episode_len_steps=7)
    plain, traced = (build_task(cfg, 5, seed=2, gradients=gradients) for gradients in (None, torch.float32))
    assert not any(rows.apart for rows in (plain._judge.rows, plain._observer.rows))
    for task in (plain, traced):
        task.reset()
        task.stagger()
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        action = torch.rand(5, 4, generator=generator) - 0.5
        one, other = plain.step(action), traced.step(action.clone().requires_grad_())
        close = {"atol": 2e-4, "rtol": 2e-4}
        torch.testing.assert_close(one[0], {key: value.detach() for key, value in other[0].items()}, **close)
        torch.testing.assert_close(one[1], other[1].detach(), **close)
        assert torch.equal(one[2], other[2])
        assert torch.equal(one[3], other[3])
        assert one[4].keys() == other[4].keys()
        torch.testing.assert_close(one[4]["episode_return"], other[4]["episode_return"], **close)
        assert other[1].requires_grad
        assert not other[4]["episode_return"].requires_grad


def test_what_a_recorded_window_begins_with_stays_in_its_place() -> None:
    """A CUDA graph reads and writes the same memory at every replay: motion, actions, lines, what law and effects remember."""
    task = build_task(full_task(), 2, gradients=torch.float32)
    task.reset()

    def places() -> dict[str, int]:
        own = {name: tensor.data_ptr() for name, tensor in task.values.graph._own.items()}
        return own | {name: tensor.data_ptr() for name, tensor in task.env.gradient_tensors.items() if name in MOTION}

    results = []
    for _ in range(3):
        for _ in range(2):
            task.step(torch.full((2, 4), 0.1, requires_grad=True))
        before = {name: tensor.clone() for name, tensor in task.env.gradient_tensors.items()}
        task.detach_in_place()
        for name, tensor in task.env.gradient_tensors.items():
            assert torch.equal(tensor, before[name]), name
            assert not tensor.requires_grad
        results.append(places())
    assert len(results[0]) > len(MOTION)
    assert results[0] == results[1] == results[2]


@pytest.mark.parametrize("key", ["robot_link_state_tensor", "robot_link_body_angvel"])
def test_frames_of_links_are_refused_by_name(key: str) -> None:
    cfg = task_registry.get("position_setpoint_task_morphy")
    cfg = replace(cfg, observations={"policy": (ObservationCfg(term=key),)})
    with pytest.raises(CapabilityError, match=f"observation term '{key}': reads {key}, which has no gradient"):
        build_task(cfg, 2, gradients=torch.float32)


@pytest.mark.parametrize(("changes", "message"), [
    (
        {"rewards": {"clear": RewardCfg(term="clearance_penalty", params={"distance": 1.0})}},
        r"reward 'clear' \(clearance_penalty\): reads robot_clearance, which has no gradient",
    ),
    (
        {
            "rewards": {"there": RewardCfg(term="target_reached")},
            "command": CommandCfg(generator="sequence", params={"points": [[0.0, 0.0, 0.0]], "radius": 0.1}),
        },
        r"reward 'there' \(target_reached\): reads target_reached",
    ),
    (
        {"observations": {"policy": (ObservationCfg(term="robot_state_tensor"),)}},
        "observation term 'robot_state_tensor': reads robot_state_tensor",
    ),
])  # fmt: skip
def test_terms_without_gradient_are_refused_by_name(changes: dict[str, object], message: str) -> None:
    cfg = replace(task_registry.get("position_setpoint_task"), **changes)
    build_task(cfg, 2)
    assert_refused(CapabilityError, message, build_task, cfg, 2, gradients=torch.float32)


def test_images_and_captures_are_refused() -> None:
    make = task_registry.make_task
    with pytest.raises(CapabilityError, match=r"'nearest_in_cells': reads nearest_in_8x8_cells, which has no gradient"):
        make("navigation_task", num_envs=2, device="cpu", differentiable=True)
    cfg = replace(task_registry.get("navigation_task"), images={"depth": ImageCfg()})
    assert_refused(CapabilityError, "image 'depth': has no gradient", build_task, cfg, 2, gradients=torch.float32)
    with pytest.raises(CapabilityError, match="capture needs a CUDA device"):
        make("tracking_task", num_envs=2, device="cpu", differentiable=True, capture=True)


def test_gradients_of_a_row_do_not_depend_on_the_batch() -> None:
    gradients = []
    for num_envs in (2, 64):
        task = build_task(full_task(), num_envs, gradients=F64)
        task.reset(seed=3)
        task.env.gtd["sim_steps"].copy_(torch.arange(num_envs) % 4)
        action = torch.full((num_envs, 4), 0.1, dtype=F64, requires_grad=True)
        total = torch.zeros((), dtype=F64)
        for _ in range(STEPS):
            observation, reward, _, _, info = task.step(action)
            total = total + reward.sum() + observation["observations"].sum() + info["final_observation"].square().sum()
        gradients.append(torch.autograd.grad(total, action)[0][:2])
    torch.testing.assert_close(gradients[0], gradients[1], atol=1e-9, rtol=1e-9)
