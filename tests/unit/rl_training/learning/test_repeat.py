"""Trainings with one seed repeat bit for bit, and go on from a checkpoint as if they had not stopped."""

from collections.abc import Callable
from typing import Any

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers import apg, ppo
from aerial_gym.rl_training.trainers.native import NativeTraining
from tests.repetitions import frequent_values
from tests.unit.rl_training.learning import test_apg, test_ppo

Make = Callable[[TrainingCfg, Task], NativeTraining[Any]]
SHARED = {"separate_value_network": False, "entropy_coef": 1e-3}

TRAININGS: dict[str, tuple[TrainingCfg, Make]] = {
    "ppo, separate": (test_ppo.settings(), ppo.PpoTrainer().make_training),
    "ppo, shared": (test_ppo.settings(separate_value_network=False, clip_value=True), ppo.PpoTrainer().make_training),
    "ppo, recurrent": (test_ppo.settings(memory=8, normalize_observation=True), ppo.PpoTrainer().make_training),
    "ppo, recurrent and shared": (test_ppo.settings(memory=8, **SHARED), ppo.PpoTrainer().make_training),
    "apg": (test_apg.settings(), apg.ApgTrainer().make_training),
    "apg, a critic": (test_apg.settings(terminal_value=True, normalize_value=True), apg.ApgTrainer().make_training),
}


@pytest.mark.parametrize("name", frequent_values(TRAININGS, ("ppo, recurrent and shared", "apg, with a critic")))
def test_a_training_repeats_bit_for_bit_and_goes_on_as_if_it_had_not_stopped(name: str) -> None:
    cfg, make = TRAININGS[name]
    chosen = {"differentiable": True} if cfg.trainer == "apg" else {"capture": False}

    def train(iterations: int, state: dict[str, object] | None = None) -> tuple[dict[str, object], list[object]]:
        with task_registry.make_task(cfg.task, num_envs=cfg.num_envs, device="cpu", seed=0, **chosen) as task:
            training = make(cfg, task)
            if state is not None:
                training.load(state)
            reports = [(training.advance(), training.gauges()) for _ in range(iterations)]
            return training.state(), reports

    whole, reports = train(4)
    torch.manual_seed(99)  # nothing comes from torch's own generator
    first, before = train(2)
    second, after = train(2, first)
    assert reports[:2] == before
    assert [gauges for _, gauges in reports] == [gauges for _, gauges in before + after]
    for part in ("model", "learner", "task"):
        for name, tensor in whole[part].items():
            assert torch.equal(tensor, second[part][name]), name
