"""Proximal policy optimisation: its formulas against loops and closed forms, its steps against a task that is scripted."""

from dataclasses import replace
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import TrainingCfg, load_settings, settings_for
from aerial_gym.rl_training.learning import learner
from aerial_gym.rl_training.learning.learner import FlatAdam, bound_excess, generalized_advantages
from aerial_gym.rl_training.learning.ppo import Ppo, adapt_rate, clipped_objective, squared_error
from aerial_gym.rl_training.policies.load import make_network
from tests.refusals import assert_refused

GAMMA, LAMBDA = 0.9, 0.8


def settings(num_envs: int = 64, **ppo: object) -> TrainingCfg:
    cfg = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    numbers = {"num_minibatches": 4, "horizon": 16} | ppo
    cfg = replace(cfg, num_envs=num_envs, device="cpu", max_time_s=None, max_env_steps=100_000)
    return replace(cfg, ppo=replace(cfg.ppo, **numbers))


def test_advantages_are_the_sum_of_discounted_errors_up_to_the_end_of_the_episode() -> None:
    """Against the definition, ``A_t = sum_k (gamma lambda)^k d_(t+k)`` over the steps of the same episode, term by term."""
    generator = torch.Generator().manual_seed(0)
    steps, rows = 9, 40
    reward, value, after = (torch.randn(steps, rows, generator=generator, dtype=torch.float64) for _ in range(3))
    terminated = torch.rand(steps, rows, generator=generator) < 0.15
    ended = terminated | (torch.rand(steps, rows, generator=generator) < 0.15)
    expected = torch.zeros_like(reward)
    for row in range(rows):
        for t in range(steps):
            for k in range(t, steps):
                worth = 0.0 if terminated[k, row] else float(after[k, row])
                error = float(reward[k, row]) + GAMMA * worth - float(value[k, row])
                expected[t, row] += (GAMMA * LAMBDA) ** (k - t) * error
                if ended[k, row]:
                    break
    result = generalized_advantages(reward, value, after, terminated, ended, discount=GAMMA, decay=LAMBDA)
    torch.testing.assert_close(result, expected, atol=1e-13, rtol=0.0)
    one = torch.ones(1, 1)  # One step of reward 1 from a value of 2 to one of 5: 1 + 0.9 * 5 - 2 = 3.5, or 1 - 2 = -1
    ended, no = one.bool(), ~one.bool()
    truncated = generalized_advantages(one, 2.0 * one, 5.0 * one, no, ended, discount=GAMMA, decay=LAMBDA)
    crashed = generalized_advantages(one, 2.0 * one, 5.0 * one, ended, ended, discount=GAMMA, decay=LAMBDA)
    torch.testing.assert_close((truncated, crashed), (torch.tensor([[3.5]]), torch.tensor([[-1.0]])))


@pytest.mark.parametrize(("ratio", "advantage", "objective", "slope"), [
    (1.1, 2.0, 2.2, 2.2),  # inside: r A, and d(r A)/d(log r) = r A
    (1.5, 2.0, 2.4, 0.0),  # a good action is favoured no further than 1 + e
    (0.5, 2.0, 1.0, 1.0),  # a good action that became rare is still made likelier
    (0.5, -2.0, -1.6, 0.0),  # a bad action is avoided no further than 1 - e
    (1.5, -2.0, -3.0, -3.0),  # a bad action that became likelier is still made rarer
])  # fmt: skip
def test_the_objective_is_clipped_on_the_side_that_would_gain(ratio, advantage, objective, slope) -> None:
    log_ratio = torch.tensor(ratio).log().requires_grad_()
    result = clipped_objective(log_ratio, torch.tensor(advantage), clip_range=0.2)
    result.backward()
    assert log_ratio.grad is not None
    torch.testing.assert_close((result.detach(), log_ratio.grad), (torch.tensor(objective), torch.tensor(slope)))


def test_values_and_bounds_are_penalised_by_hand_worked_amounts() -> None:
    value, target, old = torch.tensor([1.0, 3.0]), torch.tensor([2.0, 2.0]), torch.tensor([0.0, 2.9])
    torch.testing.assert_close(squared_error(value, target, old, clip_range=None), torch.tensor([1.0, 1.0]))
    # 0 may rise to 0.2 only: (0.2 - 2)^2 = 3.24; 2.9 may rise to 3.1, so that 3 counts
    torch.testing.assert_close(squared_error(value, target, old, clip_range=0.2), torch.tensor([3.24, 1.0]))
    torch.testing.assert_close(bound_excess(torch.tensor([[1.0, -1.4], [-0.2, 1.6]])), torch.tensor([0.09, 0.25]))


def test_the_rate_follows_the_divergence_between_its_limits() -> None:
    def rate(divergence: float, *, now: float = 1e-3) -> float:
        result = adapt_rate(torch.tensor(now), torch.tensor(divergence), threshold=0.01, highest=torch.tensor(5e-3))
        return float(result)

    assert (rate(0.021), rate(0.01)) == (pytest.approx(1e-3 / 1.5), pytest.approx(1e-3))
    assert (rate(0.004), rate(0.004, now=4e-3)) == (pytest.approx(1.5e-3), pytest.approx(5e-3))
    assert rate(0.021, now=1e-6) == pytest.approx(1e-6)


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_flat_adam_is_torchs_adam_behind_a_limit_of_the_norm(scale: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learner, "PIECE", 7)
    networks = []
    for _ in range(2):
        torch.manual_seed(0)
        networks.append(torch.nn.Sequential(torch.nn.Linear(3, 5), torch.nn.Tanh(), torch.nn.Linear(5, 2)))
    flat, rate = FlatAdam(networks[0], max_norm=1.0), torch.tensor(3e-3)
    reference = torch.optim.Adam(networks[1].parameters(), lr=3e-3)
    for step in range(5):
        inputs = torch.randn(16, 3, generator=torch.Generator().manual_seed(step))
        flat.step(flat.gradient(scale * networks[0](inputs).square().mean()), rate)
        reference.zero_grad()
        (scale * networks[1](inputs).square().mean()).backward()
        torch.nn.utils.clip_grad_norm_(networks[1].parameters(), 1.0)
        reference.step()
    for actual, engine_value in zip(networks[0].parameters(), networks[1].parameters(), strict=True):
        torch.testing.assert_close(actual, engine_value, atol=2e-7, rtol=1e-5)


class StepCounter:
    """Two environments that count their steps: row 0 is truncated after 3, row 1 crashes after 2. The observation is
    the count, the reward is 1, and the last observation is told apart from the first one of the next episode."""

    num_envs, num_actions, device = 2, 1, torch.device("cpu")
    observation_shapes: ClassVar = {"observations": (1,)}

    def __init__(self) -> None:
        self.count = torch.zeros(2)

    def reset(self) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        return {"observations": self.count.clone().unsqueeze(-1)}, {}

    def stagger(self) -> None:
        """Both begin at 0."""

    def step(self, actions: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Tensor]]:
        assert float(actions.abs().max()) <= 1.0
        self.count = self.count + 1.0
        truncated = torch.tensor([bool(self.count[0] == 3.0), False])
        terminated = torch.tensor([False, bool(self.count[1] == 2.0)])
        info = dict.fromkeys(("episode_return", "episode_length"), self.count.clone())
        info["final_observation"] = self.count.clone().unsqueeze(-1)
        self.count = self.count.masked_fill(terminated | truncated, 0.0)
        return {"observations": self.count.clone().unsqueeze(-1)}, torch.ones(2), terminated, truncated, info


def test_returns_bootstrap_with_the_value_of_the_last_observation() -> None:
    """With a critic that gives ten times the count: V(final) of row 0 is 30; the first of its next episode would be 0."""
    cfg = settings(2, horizon=4, gae_lambda=1.0, discount=0.9, normalize_observation=False, normalize_value=False)
    cfg = replace(cfg, ppo=replace(cfg.ppo, hidden_layers=(1,), activation="relu", reward_scale=1.0, num_minibatches=1))
    task = StepCounter()
    network = make_network(cfg, task)
    layer = network.own_body.layers[0]
    for tensor, number in ((layer.weight, 1.0), (layer.bias, 0.0), (network.value_head.weight, 10.0)):
        tensor.data.fill_(number)
    learner = Ppo(cfg, task, network)
    learner.restart_episodes()
    with torch.no_grad():
        samples = learner._segment_samples(learner._simulate_segment())
    row0 = [1 + 0.9 * (1 + 0.9 * (1 + 0.9 * 30)), 1 + 0.9 * (1 + 0.9 * 30), 1 + 0.9 * 30, 1 + 0.9 * 10]
    row1 = [1 + 0.9 * 1, 1.0, 1 + 0.9 * 1, 1.0]
    torch.testing.assert_close(samples.in_time["target"], torch.tensor([row0, row1]).T)
    assert learner.sums.tolist() == [8.0, 3.0, 3.0 + 2.0 + 2.0, 7.0]


def test_settings_that_do_not_fit_trainer_or_task_are_refused() -> None:
    cfg = load_settings(settings_for("rl_games", "position_setpoint_task"))
    assert_refused(
        ConfigError,
        "memory, policy_keys, critic_keys, sets and opponents",
        replace,
        cfg,
        ppo=replace(cfg.ppo, memory=8),
    )
    with pytest.raises(ConfigError, match="a critic with keys of its own needs separate_value_network"):
        replace(cfg.ppo, separate_value_network=False, critic_keys=("critic",))
    with pytest.raises(ConfigError, match="has no observation 'depth'. Known: observations"):
        make_network(settings(policy_keys=("observations", "depth")), StepCounter())
