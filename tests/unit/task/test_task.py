"""Gymnasium semantics of a task, its reward against numbers worked out by hand, and its independence of the batch."""

from collections.abc import Callable
from dataclasses import replace
from math import exp

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from tests.unit.task.hover import camera_task, rich, term_reward


def make(num_envs: int = 8, *, seed: int = 0, **changes: object) -> Task:
    task = task_registry.make_task("position_setpoint_task", num_envs=num_envs, device="cpu", seed=seed)
    return Task(replace(task.cfg, **changes), task.env) if changes else task


def test_spaces_and_shapes() -> None:
    task = make(5)
    obs, info = task.reset()
    assert obs["observations"].shape == (5, 13)
    assert info == {}
    assert task.observation_space["observations"].shape == (13,)
    assert task.action_space.shape == (4,)
    obs, reward, terminated, truncated, info = task.step(torch.zeros(5, 4))
    assert obs["observations"].shape == info["final_observation"].shape == (5, 13)
    assert reward.shape == terminated.shape == truncated.shape == (5,)
    assert terminated.dtype == truncated.dtype == torch.bool
    with make(2) as task:
        task.reset()
    assert not hasattr(task.env, "robot_manager")


def test_an_episode_lasts_exactly_as_long_as_configured_and_ends_by_time_out() -> None:
    task = make(4, episode_len_steps=7)
    task.reset()
    for step in range(1, 16):
        _, _, terminated, truncated, info = task.step(torch.zeros(4, 4))
        assert not terminated.any()
        assert truncated.all() == (step % 7 == 0)
        assert torch.equal(info["time_outs"], truncated)
        assert (info["episode_length"] == (step - 1) % 7 + 1).all()


def test_final_observation_is_of_the_old_episode_and_the_observation_of_the_new() -> None:
    task = make(4, episode_len_steps=5)
    task.reset()
    previous = None
    for _ in range(5):
        obs, *_, truncated, info = task.step(torch.tensor([0.5, 0.3, 0.0, 0.0]).expand(4, 4))
        if not truncated.any():
            torch.testing.assert_close(obs["observations"], info["final_observation"])
            previous = obs["observations"].clone()
    assert truncated.all()
    assert (info["final_observation"][:, :3] - previous[:, :3]).norm(dim=-1).max() < 0.05
    assert (obs["observations"][:, :3] - info["final_observation"][:, :3]).norm(dim=-1).min() > 1e-3
    torch.testing.assert_close(obs["observations"][:, :3], -task.env.gtd["robot_position"])


def test_flying_away_is_a_crash_with_its_penalty_and_no_time_out() -> None:
    terminations = task_registry.get("position_setpoint_task").terminations
    near = replace(terminations["far_away"], params={"distance": 1.5})
    task = make(4, terminations={**terminations, "far_away": near})
    task.reset()
    for _ in range(200):
        _, reward, terminated, truncated, info = task.step(torch.tensor([0.0, 0.6, 0.0, 0.0]).expand(4, 4))
        if terminated.any():
            break
    assert terminated.any()
    assert (reward[terminated] == -20.0).all()
    assert not (terminated & truncated).any()
    assert not info["time_outs"][terminated].any()
    far = info["final_observation"][terminated][:, :3].norm(dim=-1)
    assert (far > 1.5).all()


def test_return_and_length_belong_to_the_finished_episode() -> None:
    task = make(3, episode_len_steps=4)
    task.reset()
    total = torch.zeros(3)
    for _ in range(4):
        _, reward, _, _, info = task.step(torch.zeros(3, 4))
        total += reward
        assert (task.episode_return == info["episode_return"]).all() == (task.env.gtd["sim_steps"] > 0).all()
    torch.testing.assert_close(info["episode_return"], total)
    _, reward, _, _, info = task.step(torch.zeros(3, 4))
    torch.testing.assert_close(info["episode_return"], reward)


def make_state(position: list[float], *, attitude: list[float], ang_vel: list[float]) -> dict[str, torch.Tensor]:
    rows = {"target_position": [0.0] * 3, "robot_position": position, "robot_orientation": attitude}
    rows |= {"robot_body_angvel": ang_vel}
    return {name: torch.tensor([row], dtype=torch.float64) for name, row in rows.items()}


LEVEL = [0.0, 0.0, 0.0, 1.0]
ROLLED = [0.5**0.5, 0.0, 0.0, 0.5**0.5]  # By 90 degrees: body z is horizontal, R33 = 0


@pytest.mark.parametrize(("position", "attitude", "ang_vel", "expected"), [
    # at the target, level, still: 5 + 20/40 + 5 (0.2/0.1 + 3)
    ([0.0, 0.0, 0.0], LEVEL, [0.0, 0.0, 0.0], 5.0 + 0.5 + 5.0 * 5.0),
    # half a metre away: pos = 3 exp(-2) + 2 exp(-1), linear part 19.5/40
    ([0.3, 0.4, 0.0], LEVEL, [0.0, 0.0, 0.0], (3 * exp(-2) + 2 * exp(-1)) * 6.0 + 19.5 / 40),
    # on its side: up = 0.2 / 1.1
    ([0.0, 0.0, 0.0], ROLLED, [0.0, 0.0, 0.0], 5.0 + 0.5 + 5.0 * (0.2 / 1.1 + 3.0)),
    # turning with |w|² = 2: spin = 1
    ([0.0, 0.0, 0.0], LEVEL, [1.0, 0.0, -1.0], 5.0 + 0.5 + 5.0 * (2.0 + 1.0)),
])  # fmt: skip
def test_reward_is_the_published_formula(position, attitude, ang_vel, expected) -> None:
    task, state = make(1), make_state(position, attitude=attitude, ang_vel=ang_vel)
    assert term_reward(task, state).item() == pytest.approx(expected, rel=1e-12)
    assert term_reward(task, state, crash=torch.tensor([True])).item() == -20.0


def fly(task: Task, first: int = 0, *, steps: int = 9) -> list[dict[str, Tensor]]:
    results, number = [], torch.arange(first, first + task.num_envs)
    for step in range(steps):
        task.env.gtd["sim_steps"].masked_fill_((number + step) % 4 == 0, task.cfg.episode_len_steps)
        actions = 0.3 * torch.sin(number.float().unsqueeze(-1) + step + torch.arange(4.0))
        observation, reward, terminated, truncated, info = task.step(actions)
        row = {"reward": reward, "terminated": terminated, "truncated": truncated} | info
        row |= {f"observed {name}": value for name, value in observation.items()}
        row |= {"command": task.env.gtd["robot_actions"], "target": task.target_position}
        results.append({name: value.clone() for name, value in row.items()})
    return results


def assert_same(result: list[dict[str, Tensor]], expected: list[dict[str, Tensor]], rows: slice) -> None:
    for a, b in zip(result, expected, strict=True):
        assert a.keys() == b.keys()
        assert not [name for name in a if not torch.equal(a[name], b[name][rows])]


MAKERS = pytest.mark.parametrize("maker", [rich, camera_task])


@MAKERS
def test_a_reset_forgets_what_came_earlier(maker: Callable[..., Task]) -> None:
    task = maker(3, seed=1)
    task.reset(seed=1)
    expected = fly(task)
    task.reset(seed=1)
    assert_same(fly(task), expected, slice(None))


def test_arrays_act_as_tensors_do_and_the_text_states_the_sizes() -> None:
    actions, rewards = torch.full((2, 4), 0.2), []
    for each in (actions, actions.double().numpy(), actions.tolist()):
        task = make(2)
        task.reset()
        rewards.append(task.step(each)[1].clone())
    assert torch.equal(rewards[0], rewards[1])
    assert torch.equal(rewards[0], rewards[2])
    assert repr(task).splitlines()[1:] == [
        "  2 environments on cpu, episodes of 500 steps of 0.01 s",
        "  each: observations (13,); action (4,); robot base_quadrotor",
    ]
