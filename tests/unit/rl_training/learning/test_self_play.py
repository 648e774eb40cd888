"""Self-play of pursuers and an evader: opponents, the evader's motion, rewards of both sides, and resumption."""

from collections.abc import Mapping
from dataclasses import replace
from math import exp

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import Policy, TrainingCfg, evaluate, load_settings
from aerial_gym.rl_training.learning.self_play import KEEP_EVERY, RULE, OpponentPool, SelfPlay
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.pursuit import PursuitPilot, set_evader
from aerial_gym.rl_training.settings import TRAINING_CONFIGS
from aerial_gym.rl_training.trainers.learners import PpoTrainer

E, V = 8, 3
SPEED, LAG_S = 2.6, 0.2  # Of the evader in pursuit_task


def settings(**changes: object) -> TrainingCfg:
    cfg = load_settings(TRAINING_CONFIGS / "ppo_pursuit.yaml")
    sizes: dict[str, object] = {"hidden_layers": (16, 16), "horizon": 8, "num_minibatches": 2, "opponents": 2}
    ppo = replace(cfg.ppo, **(sizes | changes))
    return replace(cfg, ppo=ppo, num_envs=E, device="cpu", max_time_s=None, max_env_steps=1_000_000)


def pursuit(episode_len_steps: int = 400) -> Task:
    length = [f"task.episode_len_steps={episode_len_steps}"]
    return task_registry.make_task("pursuit_task", num_envs=E, device="cpu", seed=4, settings=length)


def small_policy(seed: int, *, num_actions: int = 3, width: int = 5) -> Policy:
    torch.manual_seed(seed)
    return Policy(NetworkBodyCfg(shapes={"evader": (width,)}, hidden_layers=(8,)), num_actions)


def test_opponents_act_like_the_policies_that_were_kept() -> None:
    """A batch of kept policies gives each environment the action of the policy that it drew."""
    generator, policy = torch.Generator().manual_seed(0), small_policy(0)
    pool = OpponentPool(policy, 2, 6, with_rule=False)
    kept = []
    for seed in (1, 2, 3):
        policy.load_state_dict(small_policy(seed).state_dict())
        kept.append(small_policy(seed))
        pool.update(torch.tensor(seed < 3), generator)
    seen, choice = {"evader": torch.randn(6, 5)}, torch.tensor([0, 1, 2, 2, 1, 0])
    expected = torch.stack([(kept[2], kept[0], kept[1])[i](seen)[row] for row, i in enumerate(choice.tolist())])
    with torch.no_grad():
        torch.testing.assert_close(pool.actions(seen, choice), expected)


def test_the_kept_policies_are_a_uniform_sample_of_all() -> None:
    """After n policies each is kept with probability K / n; 4 standard deviations of a binomial number."""
    generator, policy, trials, n, size = torch.Generator().manual_seed(0), small_policy(0), 400, 8, 2
    counts = torch.zeros(n)
    for _ in range(trials):
        pool = OpponentPool(policy, size, 1, with_rule=False)
        for number in range(n):
            policy.head.bias.data.fill_(number)
            pool.update(torch.tensor(True), generator)
        counts[pool.state_tensors()["kept.head.bias"][1:, 0].long()] += 1
    share = size / n
    assert (counts - trials * share).abs().max() < 4.0 * (trials * share * (1.0 - share)) ** 0.5


@pytest.mark.parametrize("with_rule", [False, True])
def test_opponents_are_drawn_where_an_episode_begins(with_rule: bool) -> None:
    generator, pool = torch.Generator().manual_seed(0), OpponentPool(small_policy(0), 2, 4000, with_rule=with_rule)
    first, begins = RULE if with_rule else 0, torch.arange(4000) < 3000
    pool.update(torch.tensor(True), generator)
    pool.draw(begins, generator)
    assert bool((pool.choice[3000:] == first).all())
    numbers = pool.choice[:3000].bincount(minlength=3) if not with_rule else (pool.choice[:3000] + 1).bincount()
    drawn = numbers[numbers > 0]  # one policy is kept by now
    assert len(drawn) == 2 - first
    assert (drawn - 3000 / len(drawn)).abs().max() < 4.0 * 3000**0.5


def test_a_learned_evader_has_the_speed_and_lag_of_the_rule() -> None:
    """From rest it reaches ``speed (1 - exp(-t / lag))`` along its action, which is limited to the unit ball."""
    task = pursuit()
    task.reset()
    action = torch.tensor([[0.0, 1.0, 1.0]]).expand(E, 3)
    set_evader(task, action, torch.arange(E) < 4)
    steps = 3
    for _ in range(steps):
        task.step(torch.zeros(E * V, 4))
    velocity = task.values.own["target_velocity"].unflatten(0, (E, V))
    expected = SPEED * (1.0 - exp(-steps * task.env.dt / LAG_S)) * torch.tensor([0.0, 0.5**0.5, 0.5**0.5])
    torch.testing.assert_close(velocity[:4], expected.expand(4, V, 3), atol=2e-5, rtol=1e-5)
    assert (velocity[4:] - expected).norm(dim=-1).min() > 0.1  # these flee by the rule


def test_the_evader_gains_what_its_pursuers_lose() -> None:
    task = pursuit()
    learner = PpoTrainer().make_training(settings(), task).learner
    assert isinstance(learner, SelfPlay)
    view = learner._views[1]
    results: list[tuple[Tensor, ...]] = []
    original = task.step

    def step(action: Tensor) -> object:
        results.append(original(action))  # type: ignore[arg-type]
        return results[-1]

    task.step = step  # type: ignore[method-assign,assignment]
    with torch.no_grad():
        seen, reward, terminated, _, info = view.step(torch.zeros(E, 3))
    _, of_pursuers, ended, _, told = results[0]
    torch.testing.assert_close(reward, -of_pursuers.view(E, V).mean(1))
    torch.testing.assert_close(info["episode_return"], -told["episode_return"].view(E, V).mean(1))
    assert torch.equal(terminated, ended.view(E, V)[:, 0])
    assert seen["evader"].shape == (E, 24)


def states_equal(one: Mapping[str, object], other: Mapping[str, object]) -> bool:
    same = {
        name: states_equal(value, other[name]) if isinstance(value, Mapping) else  # type: ignore[arg-type]
        torch.equal(value, other[name]) if isinstance(value, Tensor) else value == other[name]  # type: ignore[arg-type]
        for name, value in one.items()
    }  # fmt: skip
    return one.keys() == other.keys() and all(same.values())


def test_a_self_play_goes_on_bit_for_bit_from_a_saved_state() -> None:
    training = PpoTrainer().make_training(settings(), pursuit(episode_len_steps=40))
    for _ in range(KEEP_EVERY + 1):
        training.advance()
    state = training.state()
    resumed = PpoTrainer().make_training(replace(settings(), seed=9), pursuit(episode_len_steps=40))
    resumed.load(state)
    assert states_equal(state, resumed.state())
    for each in (training, resumed):
        each.advance()
    assert states_equal(training.state(), resumed.state())
    assert int(training.state()["learner"]["evader_pool.offered"]) == 1
    assert not states_equal(state["evader"], training.state()["evader"])
    assert training.env_steps == (KEEP_EVERY + 2) * 2 * E * V * 8 == int(training.learner.sums[0])


def test_an_evaluation_flies_from_the_rule_and_from_the_learned_evader() -> None:
    """An evader that stands still is caught by vehicles that fly to it; that of the rule is not."""
    task = pursuit(episode_len_steps=100)
    still = Policy(NetworkBodyCfg(shapes={"evader": (24,)}, hidden_layers=(8,)), 3, head_variance=1e-12)

    class Chase:
        """Flies to the target: without roll, pitch and yaw the observation's error is in the vehicle frame."""

        def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
            error = observation["observations"][:, 3:6] / 0.3
            return torch.cat((error.clamp(-1.0, 1.0), torch.zeros(len(error), 1)), dim=-1)

        def reset(self, mask: Tensor | None = None) -> None:
            del mask

    before = evaluate(Chase(), task)
    result = evaluate(Chase(), task, evader=still)
    assert before.learned_evader_success_rate is None
    assert result.learned_evader_success_rate is not None
    assert result.learned_evader_success_rate > result.success_rate
    assert not task.values.own["evader_is_learned"].any()
    with pytest.raises(ConfigError, match="Fly the task of its training"):
        PursuitPilot(Chase(), small_policy(0), task)


def test_self_play_without_an_evader_or_with_memory_is_refused() -> None:
    task = task_registry.make_task("formation_task", num_envs=E, device="cpu")
    with pytest.raises(ConfigError, match="has no evader that learns. Train pursuit_task"):
        PpoTrainer().make_training(replace(settings(), task="formation_task"), task)
    with pytest.raises(ConfigError, match="needs policies without memory"):
        settings(memory=8)
    with pytest.raises(ConfigError, match="opponents need trainer ppo, not rl_games"):
        replace(settings(critic_keys=()), trainer="rl_games")
