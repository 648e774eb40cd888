"""A short training of several vehicles with the trainer of this package."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.cli.main import main
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import Policy, TrainingCfg, evaluate, load_policy, load_settings, train
from aerial_gym.rl_training.policies.load import load_evader
from aerial_gym.rl_training.settings import TRAINING_CONFIGS
from aerial_gym.task import Task

EPISODE = "task.episode_len_steps=80"


class Hover:
    """Hovers where it begins."""

    def __call__(self, observation: dict[str, Tensor]) -> Tensor:
        return torch.zeros(len(observation["observations"]), 4)

    def reset(self, mask: Tensor | None = None) -> None:
        del mask


def settings(**changes: object) -> TrainingCfg:
    cfg = load_settings(TRAINING_CONFIGS / "ppo_formation.yaml")
    ppo = replace(cfg.ppo, hidden_layers=(32, 32), num_minibatches=4, **changes)
    return replace(cfg, ppo=ppo, num_envs=64, device="cpu", max_time_s=None, max_env_steps=40_000, settings=(EPISODE,))


def fresh_task(*more: str) -> Task:
    return task_registry.make_task("formation_task", num_envs=64, device="cpu", seed=900, settings=[EPISODE, *more])


@pytest.mark.slow
def test_a_short_training_with_a_central_critic_brings_the_vehicles_nearer(tmp_path: Path) -> None:
    train(settings(), tmp_path / "run", show_progress=False)
    policy, _ = load_policy(tmp_path / "run")
    learned, hover = evaluate(policy, fresh_task()), evaluate(Hover(), fresh_task())
    assert learned.num_starts == 3 * 64
    assert learned.reward_terms["way"] > hover.reward_terms["way"] + 1.0  # half a metre for each vehicle
    assert learned.collision_rate is not None


NEIGHBOURS = "task.observations.neighbours=[{term: nearest_vehicles, params: {count: 2}}]"


@pytest.mark.slow
def test_attention_over_neighbours_trains_and_is_loaded(tmp_path: Path) -> None:
    cfg = settings(
        policy_keys=("observations", "neighbours"), critic_keys=("observations", "critic"), sets={"neighbours": 7}
    )
    cfg = replace(cfg, settings=(EPISODE, NEIGHBOURS), max_env_steps=20_000)
    train(cfg, tmp_path / "run", show_progress=False)
    policy, _ = load_policy(tmp_path / "run")
    assert isinstance(policy, Policy)
    assert list(policy.body.encoders) == ["neighbours"]
    assert evaluate(policy, fresh_task(NEIGHBOURS)).num_starts == 3 * 64


@pytest.mark.slow
def test_a_self_play_repeats_and_its_evader_is_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cfg = load_settings(TRAINING_CONFIGS / "ppo_pursuit.yaml")
    assert cfg.ppo is not None
    ppo = replace(cfg.ppo, hidden_layers=(16, 16), num_minibatches=2, horizon=8, opponents=2)
    cfg = replace(cfg, ppo=ppo, num_envs=16, device="cpu", max_time_s=None, max_env_steps=20_000, settings=(EPISODE,))
    evaders = []
    for name in ("one", "two"):
        train(cfg, tmp_path / name, show_progress=False)
        evaders.append(load_evader(tmp_path / name).state_dict())
    assert all(torch.equal(value, evaders[1][name]) for name, value in evaders[0].items())
    assert main(["evaluate", "--policy", str(tmp_path / "one"), "--num-envs", "8", "--json"]) == 0
    assert 0.0 <= json.loads(capsys.readouterr().out)["learned_evader_success_rate"] <= 1.0
    with pytest.raises(ConfigError, match="holds no evader"):
        load_evader("pretrained/position_setpoint_task")
