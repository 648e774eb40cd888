"""Delay and low pass of commands against their closed forms."""

from math import exp

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from aerial_gym.config.task_terms import ActionCfg, ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import ACTIONS
from aerial_gym.task.terms.actions import Action
from tests.unit.task.hover import make

STEPS = 12


def commands(cfg: ActionCfg, random_commands: torch.Tensor, *, length: int = 500) -> torch.Tensor:
    task = make(random_commands.shape[1], action=cfg, episode_len_steps=length)
    task.reset()
    result = []
    for actions in random_commands:
        task.step(actions)
        key = "robot_prev_actions" if task.env.gtd["sim_steps"][0] == 0 else "robot_actions"
        result.append(task.env.gtd[key].clone())
    return torch.stack(result)


@pytest.fixture
def random_commands() -> torch.Tensor:
    return 0.2 * torch.randn(STEPS, 3, 4, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("steps", [1, 3])
def test_a_delayed_command_is_the_one_so_many_steps_earlier(steps: int, random_commands: torch.Tensor) -> None:
    result = commands(ActionCfg(delay_steps=steps), random_commands)
    times = [max(t - steps, 0) for t in range(STEPS)]
    assert torch.equal(result, random_commands[times])


def test_the_filter_is_the_exact_low_pass_of_a_held_command(random_commands: torch.Tensor) -> None:
    """``scipy.signal.lfilter`` of y[k] = (1 - a) y[k-1] + a u[k] with a = 1 - exp(-dt / tau), begun at the first command."""
    result = commands(ActionCfg(filter_time_s=0.03), random_commands).double().numpy()
    gain = 1.0 - exp(-0.01 / 0.03)  # the step of the task is 10 ms
    u = random_commands.double().numpy()
    expected, _ = lfilter([gain], [1.0, gain - 1.0], u, axis=0, zi=(1.0 - gain) * u[:1])
    np.testing.assert_allclose(result, expected, rtol=0.0, atol=1e-6)


def test_a_command_is_delayed_and_then_filtered(random_commands: torch.Tensor) -> None:
    both = commands(ActionCfg(delay_steps=2, filter_time_s=0.05), random_commands)
    alone = commands(ActionCfg(filter_time_s=0.05), random_commands)
    torch.testing.assert_close(both[2:], alone[:-2], rtol=0.0, atol=0.0)


def test_noise_of_a_command_is_white_and_of_its_deviation() -> None:
    """Zero actions: 12 steps of 2,000 environments and 4 entries; bounds: five standard deviations."""
    zeros = torch.zeros(STEPS, 2000, 4)
    noise = commands(ActionCfg(noise_std=0.02, delay_steps=1), zeros) / 0.02
    count = noise.numel()
    assert abs(noise.mean().item()) < 5.0 / count**0.5
    assert abs(noise.var().item() - 1.0) < 5.0 * (2.0 / count) ** 0.5
    for product in (noise[1:] * noise[:-1], noise[..., 1:] * noise[..., :-1]):
        assert abs(product.mean().item()) < 5.0 / product.numel() ** 0.5
    again = commands(ActionCfg(noise_std=0.02, delay_steps=1), zeros[:, :3]) / 0.02
    assert torch.equal(again, noise[:, :3])  # whoever else flies


@pytest.mark.parametrize(("transform", "low", "message"), [
    ("affine", (0.0,) * 3, "action affine: low has 3 numbers, but this robot takes 4. Choose a robot"),
    ("tenth", (), "action tenth: cannot be computed .IndexError"),
    ("half", (), r"action half: returns \(1, 2\) for actions \(1, 4\); the controller takes \(E, U\) = \(1, 4\)"),
])  # fmt: skip
def test_a_transform_that_gives_no_command_is_refused(transform, low, message, monkeypatch) -> None:
    monkeypatch.setitem(ACTIONS._entries, "half", Action(value=lambda actions: actions[:, :2]))
    monkeypatch.setitem(ACTIONS._entries, "tenth", Action(value=lambda actions: actions.unbind(-1)[9]))
    params = {"low": low, "high": (1.0,) * 4} if low else {}
    with pytest.raises(ConfigError, match=message):
        make(1, action=ActionCfg(transform=transform, params=params))


def test_an_episode_does_not_remember_the_earlier_one(random_commands: torch.Tensor) -> None:
    result = commands(ActionCfg(delay_steps=(2, 2), filter_time_s=0.05), random_commands, length=4)
    for start in (0, 4, 8):
        fresh = commands(ActionCfg(delay_steps=2, filter_time_s=0.05), random_commands[start : start + 3])
        torch.testing.assert_close(result[start : start + 3], fresh, rtol=0.0, atol=0.0)


def test_a_drawn_delay_is_that_of_its_episode() -> None:
    given = torch.arange(1.0, 7.0).view(6, 1, 1).expand(6, 64, 4) * 0.01
    task = make(64, action=ActionCfg(delay_steps=(0, 2)))
    task.reset()
    delay = task.values["action_delay"][:, 0]
    assert sorted(set(delay.tolist())) == [0.0, 1.0, 2.0]
    for actions in given:
        task.step(actions)
    torch.testing.assert_close(task.env.gtd["robot_actions"][:, 0], 0.01 * (6.0 - delay))


def test_the_policys_own_action_can_be_observed() -> None:
    """Before transform and delay; 0 where an episode has just begun."""
    action = ActionCfg(transform="affine", params={"low": (0.0,) * 4, "high": (0.1,) * 4}, delay_steps=3)
    task = make(2, action=action, policy=(ObservationCfg(term="policy_action"),), episode_len_steps=2)
    obs, _ = task.reset()
    assert (obs["observations"] == 0.0).all()
    given = torch.tensor([[0.5, -0.5, 0.0, 1.0], [0.1, 0.2, 0.3, 0.4]])
    assert torch.equal(task.step(given)[0]["observations"], given)
    torch.testing.assert_close(task.env.gtd["robot_actions"], 0.05 * (given + 1.0))
    obs, *_, info = task.step(-given)
    assert (obs["observations"] == 0.0).all()
    assert torch.equal(info["final_observation"], -given)
