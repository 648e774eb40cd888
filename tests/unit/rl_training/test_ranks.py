"""Which device a process of several takes, and what a single one does where several would talk."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import load_settings, settings_for, train
from aerial_gym.rl_training import training as training_module
from aerial_gym.rl_training.ranks import ALONE, Ranks, process_device, torchrun_rank
from aerial_gym.rl_training.trainers.learners import PpoTrainer
from tests.refusals import assert_refused
from tests.unit.rl_training.learning.test_ppo import settings
from tests.unit.task.test_curriculum import CFG, make

THIRD = {"RANK": "2", "LOCAL_RANK": "2", "WORLD_SIZE": "4", "MASTER_ADDR": "localhost", "MASTER_PORT": "1"}


@pytest.fixture
def third_of_four(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Four GPUs, and the variables that torchrun sets."""
    for name, value in THIRD.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    return monkeypatch


def test_each_process_takes_the_gpu_of_its_local_rank(third_of_four: pytest.MonkeyPatch) -> None:
    assert torchrun_rank() == 2
    assert [process_device(name) for name in ("auto", "cuda", "cpu")] == ["cuda:2", "cuda:2", "cpu"]
    assert_refused(ConfigError, "each of 4 processes takes a GPU of its own. Leave", process_device, "cuda:0")
    third_of_four.setattr(torch.cuda, "device_count", lambda: 2)
    assert_refused(ConfigError, "LOCAL_RANK 2: this machine shows 2 GPUs", process_device, "auto")


def test_a_single_process_keeps_what_it_gives() -> None:
    assert torchrun_rank() == 0
    samples = torch.arange(6.0).view(3, 2)
    torch.testing.assert_close(ALONE.mean_(samples.clone()), samples)
    torch.testing.assert_close(ALONE.var_mean(samples), (torch.full((2,), 8 / 3), torch.tensor([2.0, 3.0])))
    assert ALONE.broadcast_number(2.0) == 2.0
    assert ALONE.any(True)
    assert not ALONE.any(False)
    assert ALONE.gather({"own": samples}) == []


class Twins(Ranks):
    """Two processes that do the same: sums are twice their own."""

    def sum_(self, tensor: torch.Tensor) -> torch.Tensor:
        return tensor.mul_(2)

    def share_(self, tensors: object) -> None:
        del tensors

    def var_mean(self, samples: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return ALONE.var_mean(samples)


def test_a_training_of_twins_learns_as_one_and_counts_the_episodes_of_both() -> None:
    result = []
    for ranks in (ALONE, Twins(0, 2, joined=True)):
        task = make(curriculum=replace(CFG, check_after=12), episode_len_steps=1, success_radius=100.0)
        training = PpoTrainer().make_training(settings(6, horizon=1, num_minibatches=2), task, ranks=ranks)
        training.advance()
        result.append((task.curriculum.state(), training.learner.sums.tolist()[:2], training.env_steps))
        weights = torch.cat([each.detach().flatten() for each in training.learner.network.parameters()])
        if ranks is ALONE:
            alone = weights
    assert result == [
        ({"level": 15, "finished": 6, "succeeded": 6}, [6.0, 6.0], 6),
        ({"level": 17, "finished": 0, "succeeded": 0}, [12.0, 12.0], 12),
    ]
    assert torch.equal(weights, alone)


def test_a_trainer_of_one_process_refuses_several(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip(
        "sample_factory", reason="Sample Factory is not installed: pip install 'aerial-gym[sample-factory]'"
    )
    monkeypatch.setattr(training_module, "join_ranks", lambda device: nullcontext(Twins(0, 2, joined=True)))
    cfg = load_settings(settings_for("sample_factory", "position_setpoint_task"))
    told = "sample_factory learns in one process, and 2 were started. Leave torchrun out"
    assert_refused(ConfigError, told, train, cfg, tmp_path / "run")
    assert not (tmp_path / "run").exists()
