"""Which device a process of several takes, and what a single one does where several would talk."""

import pytest
import torch

from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.ranks import ALONE, launched_rank, own_device

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
    assert launched_rank() == 2
    assert [own_device(name) for name in ("auto", "cuda", "cpu")] == ["cuda:2", "cuda:2", "cpu"]
    with pytest.raises(ConfigError, match="each of 4 processes takes a GPU of its own. Leave the number out"):
        own_device("cuda:0")
    third_of_four.setattr(torch.cuda, "device_count", lambda: 2)
    with pytest.raises(ConfigError, match="LOCAL_RANK 2: this machine shows 2 GPUs"):
        own_device("auto")


def test_a_single_process_keeps_what_it_gives() -> None:
    assert launched_rank() == 0
    samples = torch.arange(6.0).view(3, 2)
    torch.testing.assert_close(ALONE.mean_(samples.clone()), samples)
    torch.testing.assert_close(ALONE.var_mean(samples), (torch.full((2,), 8 / 3), torch.tensor([2.0, 3.0])))
    assert ALONE.told(2.0) == 2.0
    assert ALONE.any(True)
    assert not ALONE.any(False)
    assert ALONE.of_others({"own": samples}) == []
