"""Networks that begin as others: they do what those did, whatever they see besides, until they learn."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.config.task_terms import ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import Policy, TrainingCfg, load_policy, load_settings, settings_for, train
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.initial_weights import load_initial_weights
from aerial_gym.rl_training.trainers.ppo import PpoTrainer
from tests.unit.task.hover import build_task


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
    load_initial_weights(wide, narrow.state_dict(), where="run")
    for more in (torch.zeros(16, 4), draw_observations(4)):
        observation = {"observations": torch.cat((draw_observations(5), more), dim=1)}
        expected = policy_outputs(narrow, {"observations": draw_observations(5)})
        torch.testing.assert_close(policy_outputs(wide, observation), expected, atol=1e-6, rtol=1e-6)
    assert wide.actor.body.normalizers["observations"].std[5:].sub(1.0).abs().max() < 1e-4


def test_what_cannot_begin_so_is_refused() -> None:
    given = network(5).state_dict()
    with pytest.raises(ConfigError, match=r"run: actor.body.layers.0.weight has shape \(8, 5\), here \(7, 9\)"):
        load_initial_weights(network(9, hidden=(7, 6)), given, where="run")
    with pytest.raises(ConfigError, match="Only inputs may be added"):
        load_initial_weights(network(4), given, where="run")
    with pytest.raises(ConfigError, match="actor.log_std"):
        load_initial_weights(network(5, actions=3), given, where="run")
    with pytest.raises(ConfigError, match="has other networks"):
        load_initial_weights(network(5, hidden=(8,)), given, where="run")
    two = network(5, sensed=(3,)).state_dict()
    with pytest.raises(ConfigError, match="that see observations, sensed cannot see more"):
        load_initial_weights(network(6, sensed=(3,)), two, where="run")


def settings(steps: int = 2048, **ppo: object) -> TrainingCfg:
    cfg = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    cfg = replace(cfg, num_envs=64, device="cpu", seed=3, max_time_s=None, max_env_steps=steps)
    return replace(cfg, ppo=replace(cfg.ppo, **({"horizon": 16} | ppo)))


def test_a_training_begins_where_another_one_ended(tmp_path: Path) -> None:
    train(settings(), tmp_path / "first", show_progress=False)
    first, _ = load_policy(tmp_path / "first")
    still = {"learning_rate": 1e-12, "max_learning_rate": 1e-12, "end_learning_rate": 1e-12}
    cfg = replace(settings(**still), seed=4, initial=str(tmp_path / "first"))
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


def test_other_trainers_and_missing_runs_are_refused(tmp_path: Path) -> None:
    apg = load_settings(settings_for("apg", "position_setpoint_task", device="cpu"))
    with pytest.raises(ConfigError, match="trainer apg takes no initial networks. Use ppo"):
        replace(apg, initial="runs/first")
    with pytest.raises(ConfigError):
        train(replace(settings(), initial=str(tmp_path / "none")), tmp_path / "run", show_progress=False)
    assert not (tmp_path / "run").exists()
