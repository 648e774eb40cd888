"""Normaliser, distribution, memory and encoders of policies, against numpy, torch's own and each other."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn
from torch.distributions import Independent, Normal, kl_divergence

from aerial_gym import task_registry
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import Policy, load_policy, load_settings, settings_for, train
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.body import EPSILON, OUTLIER, NetworkBody, NetworkBodyCfg, RunningNormalizer
from aerial_gym.rl_training.policies.load import load_initial_weights
from aerial_gym.rl_training.policies.policy import Gaussian
from aerial_gym.rl_training.policies.recurrent import unroll_memory
from aerial_gym.rl_training.policies.set_encoder import SET_FEATURES, SetEncoder
from aerial_gym.rl_training.trainers.learners import PpoTrainer
from tests.refusals import assert_refused
from tests.unit.rl_training.learning.test_ppo import settings
from tests.unit.task.hover import build_task


def randn(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def test_the_normaliser_knows_all_batches_together_also_when_it_is_loaded() -> None:
    normalizer, batches = RunningNormalizer((3,)), []
    for size, spread, middle in ((1, 1.0, 0.0), (40, 2.0, 5.0), (700, 0.1, -3.0), (2, 30.0, 1.0)):
        batches.append(middle + spread * randn(size, 3, seed=size))
        normalizer.update(batches[-1])
    together = torch.cat(batches).double().numpy()
    np.testing.assert_allclose(normalizer.mean.numpy(), together.mean(0), rtol=1e-5)
    np.testing.assert_allclose(normalizer.var.numpy(), together.var(0), rtol=1e-5)
    assert float(normalizer.count) == 743
    sample = randn(5, 3)
    expected = (sample.numpy() - together.mean(0)) / np.sqrt(together.var(0) + EPSILON)
    np.testing.assert_allclose(normalizer(sample).numpy(), expected.clip(-5.0, 5.0), rtol=1e-4)
    torch.testing.assert_close(normalizer.inverse(normalizer(sample)), sample)
    normalizer, other = RunningNormalizer((3,)), RunningNormalizer((3,))
    normalizer.update(4.0 + randn(50, 3))
    other.load_state_dict(normalizer.state_dict())
    assert torch.equal(normalizer(randn(5, 3)), other(randn(5, 3)))


def test_one_impossible_return_does_not_spoil_what_comes_after_it() -> None:
    """Of 4,000 returns one is -2e7: it counts as 100 deviations, 1 + 100² / 8000 in variance; without that, 5e10."""
    bounded, plain = RunningNormalizer(limit=np.inf, outlier=OUTLIER), RunningNormalizer(limit=np.inf)
    ordinary, wrong = randn(4000), randn(4000, seed=1)
    wrong[17] = -2e7
    for normalizer in (bounded, plain):
        normalizer.update(ordinary)
        normalizer.update(wrong)
    assert float(bounded.var) == pytest.approx(1.0 + 1e4 / 8000, rel=0.05)
    assert float(plain.var) > 1e10
    first = RunningNormalizer(outlier=OUTLIER)
    first.update(500.0 + 200.0 * ordinary)  # nothing is known before the first ones
    assert float(first.mean) == pytest.approx(500.0, rel=0.05)


def test_the_distribution_is_that_of_torch() -> None:
    mean, log_std, action, noise = randn(6, 4), 0.3 * randn(4, seed=1), randn(6, 4, seed=2), randn(6, 4, seed=3)
    actual, engine_value = Gaussian(mean, log_std), Independent(Normal(mean, log_std.exp()), 1)
    torch.testing.assert_close(actual.log_prob(action), engine_value.log_prob(action))
    torch.testing.assert_close(actual.entropy().expand(6), engine_value.entropy())
    torch.testing.assert_close(actual.sample(noise), mean + log_std.exp() * noise)
    old_mean, old_log_std = randn(6, 4, seed=4), 0.3 * randn(4, seed=5)
    expected = kl_divergence(Independent(Normal(old_mean, old_log_std.exp()), 1), engine_value)
    torch.testing.assert_close(actual.divergence(old_mean, old_log_std), expected)


def recurrent() -> NetworkBodyCfg:
    return NetworkBodyCfg(shapes={"observations": (5,)}, hidden_layers=(8,), memory=6)


def test_a_sequence_is_its_steps_one_by_one_with_the_memory_emptied_where_episodes_begin() -> None:
    policy = Policy(recurrent(), 2)
    seen, begins = randn(7, 10, 5), torch.rand(7, 10, generator=torch.Generator().manual_seed(1)) < 0.3
    first = randn(10, 6, seed=2)
    features, after = policy.body.sequence_outputs(policy.body.network_inputs({"observations": seen}), first, begins)
    memory = first
    for t in range(7):
        memory = torch.where(begins[t].unsqueeze(-1), 0.0, memory)
        mean, memory = policy.step({"observations": seen[t]}, memory)
        torch.testing.assert_close(policy.head(features[t]), mean)
        torch.testing.assert_close(after[t], memory)


GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


@pytest.mark.parametrize(
    ("device", "size"), [("cpu", 6), *(pytest.param("cuda", size, marks=GPU) for size in (6, 16, 32, 64, 128))]
)
def test_gradients_along_a_sequence_are_those_of_the_unit_step_by_step(device: str, size: int) -> None:
    torch.manual_seed(0)
    cell = nn.GRUCell(5, size, device=device)
    shapes = ((7, 21, 5), (21, size), (7, 21, size))
    seen, first, weight = (randn(*shape, seed=i).to(device) for i, shape in enumerate(shapes))
    begins = (torch.rand(7, 21, generator=torch.Generator().manual_seed(1)) < 0.3).to(device)
    wanted = [seen.requires_grad_(), first.requires_grad_(), *cell.parameters()]
    memory, loss = first, torch.zeros((), device=device)
    for t in range(7):
        memory = cell(seen[t], torch.where(begins[t].unsqueeze(-1), 0.0, memory))
        loss = loss + (memory * weight[t]).sum()
    expected = torch.autograd.grad(loss, wanted)
    result = torch.autograd.grad((unroll_memory(cell, seen, first, begins) * weight).sum(), wanted)
    for actual, reference in zip(result, expected, strict=True):
        torch.testing.assert_close(actual, reference, atol=1e-5, rtol=1e-5)


def test_a_policy_forgets_where_it_is_told_to_and_nowhere_else() -> None:
    policy = Policy(recurrent(), 2)
    seen = {"observations": randn(3, 5)}
    fresh, later = policy(seen), policy(seen)
    assert (fresh != later).any(dim=-1).all()
    policy.reset()
    policy(seen)
    policy.reset(torch.tensor([False, True, False]))
    mixed = policy(seen)
    assert torch.equal(mixed[1], fresh[1])
    assert torch.equal(mixed[::2], later[::2])


@pytest.mark.parametrize("shared", [False, True])
def test_memories_of_policy_and_critic_stand_apart(shared: bool) -> None:
    network = ActorCritic(Policy(recurrent(), 2), None if shared else recurrent())
    torch.nn.init.normal_(network.value_head.weight)
    assert network.empty_memory(3).shape == (3, 6 if shared else 12)
    prepared, begins = network.network_inputs({"observations": randn(6, 3, 5)}), torch.zeros(6, 3, dtype=torch.bool)
    first = randn(3, sum(network.memory_sizes), seed=1)
    whole, remembered = network.values(prepared, first, begins)
    acting = network.actor.body.sequence_outputs(prepared, first[:, :6], begins)[1][2]
    second = network.join_memory(acting, remembered[2])
    half, _ = network.values({key: value[3:] for key, value in prepared.items()}, second, begins[3:])
    torch.testing.assert_close(half, whole[3:])
    one = network.next_values({key: value[3:4] for key, value in prepared.items()}, remembered[2:3])
    torch.testing.assert_close(one, whole[3:4])


def test_a_critic_sees_its_own_keys_and_what_both_see_is_normalised_alike() -> None:
    both, more = {"observations": (5,)}, {"observations": (5,), "critic": (3,)}
    policy = Policy(NetworkBodyCfg(shapes=both, hidden_layers=(8,)), 2)
    network = ActorCritic(policy, NetworkBodyCfg(shapes=more, hidden_layers=(8,)))
    torch.nn.init.normal_(network.value_head.weight)
    observation = {"observations": 3.0 + randn(4, 6, 5), "critic": randn(4, 6, 3, seed=1)}
    network.update_normalizers(observation)
    normalizer = network.actor.body.normalizers["observations"]
    assert float(normalizer.count) == 24.0
    torch.testing.assert_close(normalizer.mean, observation["observations"].mean((0, 1)))

    def look(seen: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        begins = torch.zeros(4, 6, dtype=torch.bool)
        distribution, value = network.sequence_outputs(network.network_inputs(seen), network.empty_memory(6), begins)
        return distribution.mean, value

    mean, value = look(observation)
    other_mean, other_value = look(observation | {"critic": randn(4, 6, 3, seed=2)})
    assert torch.equal(mean, other_mean)
    assert (value != other_value).all()


def test_images_are_encoded_with_any_leading_dimensions_and_bytes_stand_for_0_to_1() -> None:
    shapes = {"observations": (3,), "depth": (1, 24, 40)}
    body = NetworkBody(NetworkBodyCfg(shapes=shapes, hidden_layers=(8,)))
    images = torch.randint(0, 256, (2, 5, 1, 24, 40), dtype=torch.uint8, generator=torch.Generator().manual_seed(0))
    seen, empty, begins = randn(2, 5, 3), torch.zeros(5, 0), torch.zeros(2, 5, dtype=torch.bool)
    features, _ = body.sequence_outputs({"observations": seen, "depth": images}, empty, begins)
    assert features.shape == (2, 5, 8)
    as_floats, _ = body.sequence_outputs({"observations": seen, "depth": images / 255.0}, empty, begins)
    torch.testing.assert_close(features, as_floats)
    with torch.no_grad():
        torch.testing.assert_close(
            body.sequence_outputs({"observations": seen, "depth": images}, empty, begins)[0], features
        )
    other = images.clone()
    other[1, 2] = 255 - other[1, 2]
    changed, _ = body.sequence_outputs({"observations": seen, "depth": other}, empty, begins)
    expected = torch.tensor([[False] * 5, [False, False, True, False, False]])
    assert torch.equal((changed != features).any(dim=-1), expected)


def network(width: int, *, hidden: tuple[int, ...] = (8, 6), actions: int = 2, **more: tuple[int, ...]) -> ActorCritic:
    body = NetworkBodyCfg(shapes={"observations": (width,), **more}, hidden_layers=hidden)
    return ActorCritic(Policy(body, actions), body)


def policy_outputs(of: ActorCritic, observation: Mapping[str, Tensor]) -> list[Tensor]:
    memory, begins = of.empty_memory(len(observation["observations"])), torch.zeros(1, 16, dtype=torch.bool)
    prepared = {key: value.unsqueeze(0) for key, value in of.network_inputs(observation).items()}
    acting, value = of.sequence_outputs(prepared, memory, begins)
    return [acting.mean, acting.log_std, value]


def draw_observations(width: int) -> Tensor:
    return 3.0 * torch.randn(16, width, generator=torch.Generator().manual_seed(width))


def test_a_wider_network_does_what_the_other_one_did_whatever_it_sees_in_addition() -> None:
    narrow, wide = network(5), network(9)
    narrow.update_normalizers({"observations": draw_observations(5)})
    torch.nn.init.normal_(narrow.value_head.weight)
    load_initial_weights(wide, narrow.state_dict(), narrow.shapes, where="run")
    for more in (torch.zeros(16, 4), draw_observations(4)):
        observation = {"observations": torch.cat((draw_observations(5), more), dim=1)}
        expected = policy_outputs(narrow, {"observations": draw_observations(5)})
        torch.testing.assert_close(policy_outputs(wide, observation), expected, atol=1e-6, rtol=1e-6)
    assert wide.actor.body.normalizers["observations"].std[5:].sub(1.0).abs().max() < 1e-4


def test_what_cannot_begin_so_is_refused() -> None:
    def load(into: ActorCritic, given: ActorCritic) -> None:
        load_initial_weights(into, given.state_dict(), given.shapes, where="run")

    given = network(5)
    with pytest.raises(ConfigError, match=r"run: actor.body.layers.0.weight has shape \(8, 5\), here \(7, 9\)"):
        load(network(9, hidden=(7, 6)), given)
    assert_refused(ConfigError, "Only inputs may be added", load, network(4), given)
    assert_refused(ConfigError, "actor.log_std", load, network(5, actions=3), given)
    assert_refused(ConfigError, "has other networks", load, network(5, hidden=(8,)), given)
    assert_refused(ConfigError, "Only inputs may be added", load, network(6, sensed=(2,)), network(5, sensed=(3,)))


def test_each_key_may_have_more_inputs() -> None:
    narrow, wide = network(5, sensed=(3,)), network(7, sensed=(4,))
    seen = {"observations": draw_observations(5), "sensed": draw_observations(3)}
    narrow.update_normalizers(seen)
    torch.nn.init.normal_(narrow.value_head.weight)
    load_initial_weights(wide, narrow.state_dict(), narrow.shapes, where="run")
    more = {key: torch.cat((value, draw_observations(n)), dim=1)
            for (key, value), n in zip(seen.items(), (2, 1), strict=True)}  # fmt: skip
    torch.testing.assert_close(policy_outputs(wide, more), policy_outputs(narrow, seen), atol=1e-6, rtol=1e-6)


def test_a_training_begins_where_another_one_ended(tmp_path: Path) -> None:
    cfg = replace(settings(), seed=3, max_env_steps=2048)
    train(cfg, tmp_path / "first", show_progress=False)
    first, _ = load_policy(tmp_path / "first")
    still = {"learning_rate": 1e-12, "max_learning_rate": 1e-12, "end_learning_rate": 1e-12}
    cfg = replace(cfg, ppo=replace(cfg.ppo, **still), seed=4, initial=str(tmp_path / "first"))
    train(cfg, tmp_path / "second", show_progress=False)
    second, _ = load_policy(tmp_path / "second")
    torch.testing.assert_close(second.head.weight, first.head.weight, atol=1e-7, rtol=0.0)

    task = task_registry.get("position_setpoint_task")
    terms = (*task.observations["policy"], ObservationCfg(term="lin_vel_body"))
    given = replace(task, observations={**task.observations, "policy": terms})
    training = PpoTrainer().make_training(cfg, build_task(given, 64))
    training.load_initial_weights(cfg.initial)
    wide, narrow = training.learner.network.actor, draw_observations(first.shapes["observations"][0])
    result = wide({"observations": torch.cat((narrow, draw_observations(3)), dim=1)})
    torch.testing.assert_close(result, first({"observations": narrow}), atol=1e-6, rtol=0.0)


def test_other_trainers_missing_runs_and_unknown_shapes_are_refused(tmp_path: Path) -> None:
    apg = load_settings(settings_for("apg", "position_setpoint_task", device="cpu"))
    assert_refused(ConfigError, "trainer apg takes no initial networks. Use ppo", replace, apg, initial="runs/first")
    with pytest.raises(ConfigError):
        train(replace(settings(), initial=str(tmp_path / "none")), tmp_path / "run", show_progress=False)
    assert not (tmp_path / "run").exists()
    with pytest.raises(ConfigError, match=r"observation 'grid' has shape \(2, 3\): must be a vector"):
        NetworkBody(NetworkBodyCfg(shapes={"grid": (2, 3)}, hidden_layers=(8,)))


def entities(*shape: int, seed: int = 0) -> Tensor:
    """Return random entities of seven numbers, all of which are there."""
    rows = randn(*shape, 7, seed=seed)
    rows[..., 6] = 1.0
    return rows


def test_a_set_has_no_order_and_ignores_what_is_not_there() -> None:
    torch.manual_seed(0)
    encoder, rows = SetEncoder(7, "elu"), entities(2, 5, 4)
    features = encoder(rows.flatten(-2))
    assert features.shape == (2, 5, SET_FEATURES)
    torch.testing.assert_close(encoder(rows[..., [2, 0, 3, 1], :].flatten(-2)), features)
    absent = torch.full((2, 5, 3, 7), torch.nan)
    absent[..., 6] = 0.0
    torch.testing.assert_close(encoder(torch.cat((rows, absent), dim=-2).flatten(-2)), features)
    assert torch.equal(encoder(torch.zeros(2, 28)), torch.zeros(2, SET_FEATURES))
    assert (encoder(entities(2, 5, 4, seed=1).flatten(-2)) - features).abs().max() > 1e-3


def test_each_entity_of_a_set_matters_and_has_a_gradient() -> None:
    torch.manual_seed(0)
    encoder, rows = SetEncoder(7, "tanh"), entities(1, 3).requires_grad_()
    encoder(rows.flatten(-2)).square().sum().backward()
    assert rows.grad is not None
    assert (rows.grad[..., :6].abs().amax(-1) > 1e-6).all()
    empty = torch.zeros(1, 21, requires_grad=True)
    encoder(empty).sum().backward()
    assert empty.grad is not None
    assert empty.grad.isfinite().all()


def test_a_body_takes_sets_beside_vectors() -> None:
    cfg = NetworkBodyCfg(shapes={"own": (5,), "others": (21,)}, hidden_layers=(8,), sets={"others": 7})
    body = NetworkBody(cfg)
    assert list(body.normalizers) == ["own"]
    seen = {"own": randn(4, 5), "others": entities(4, 3).flatten(-2)}
    features, _ = body(body.network_inputs(seen), torch.zeros(4, 0))
    assert features.shape == (4, 8)
    with pytest.raises(ConfigError, match=r"'others' has shape \(20,\): must be .* whole entities of sets"):
        NetworkBody(replace(cfg, shapes={"others": (20,)}))
