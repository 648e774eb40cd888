"""Policies that come with the package: what they hold, how they fly, and where else their names work."""

from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym import evaluate, task_registry
from aerial_gym.cli.main import main
from aerial_gym.config.storage import read_archive
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.rl_training import load_policy
from aerial_gym.rl_training.policies.catalog import PREFIX, PRETRAINED, policy_path
from aerial_gym.rl_training.run.run_folder import ARRAYS
from benchmarks.learning.policies import pack_run
from tests.refusals import assert_refused
from tests.repetitions import frequent_values

NAMES = PRETRAINED.names()
STARTS = 32


def test_five_policies_take_less_than_a_megabyte() -> None:
    assert len(NAMES) == 5
    assert set(NAMES) <= set(task_registry.names())
    assert all(PRETRAINED.get(name).path.is_dir() for name in NAMES)
    assert all(line.startswith("policy that can ") for line in PRETRAINED.summaries().values())
    files = [policy_path(PREFIX / name) / ARRAYS for name in NAMES]
    assert sum(file.stat().st_size for file in files) < 1_000_000


@pytest.mark.parametrize("name", NAMES)
def test_a_policy_holds_plain_arrays_and_its_command(name: str) -> None:
    with np.load(policy_path(PREFIX / name) / ARRAYS, allow_pickle=False) as arrays:
        assert all(np.isfinite(arrays[key]).all() for key in arrays.files)
    _, cfg = load_policy(PREFIX / name)
    assert cfg.task == name
    assert cfg.source.startswith(f"made by: aerial-gym train --task {name} ")


@pytest.mark.parametrize("name", frequent_values(NAMES, ("position_setpoint_task",)))
def test_a_policy_flies_its_task(name: str) -> None:
    assert evaluate(PREFIX / name, num_envs=STARTS).success_rate >= 0.9


def test_a_local_file_comes_before_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    name = PREFIX / NAMES[0]
    assert policy_path(name).is_absolute()
    name.mkdir(parents=True)
    assert policy_path(str(name)) == name
    assert_refused(UnknownNameError, "no pretrained policy 'hover'. .*Known: ", policy_path, "pretrained/hover")


def test_pretrained_policies_can_be_exported_and_begin_a_training(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    hover = "pretrained/position_setpoint_task"
    assert main(["export", "--policy", hover, "--to", "torchscript", "--no-check"]) == 0
    assert [path.suffix for path in sorted((tmp_path / "export").iterdir())] == [".json", ".pt"]
    limits = ["--num-envs", "64", "--max-env-steps", "2048", "--device", "cpu"]
    assert main(["train", "--initial", hover, "--out", "run", *limits]) == 0
    assert evaluate("run", num_envs=8).success_rate == 1.0
    capsys.readouterr()


def test_packed_weights_are_those_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.learning.policies.CONFIG_DIR", tmp_path)
    source = policy_path(PREFIX / NAMES[0])
    copy = pack_run(source, "aerial-gym train")
    first, second = (read_archive(folder / ARRAYS, "policy")["model"] for folder in (source, copy))
    assert first.keys() == second.keys()
    assert all(torch.equal(first[key], second[key]) for key in first)


def test_pickled_or_damaged_arrays_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "policy.npz"
    np.savez(file, weights=np.array([{}], dtype=object))
    assert_refused(ConfigError, "holds more than tensors", read_archive, file, "policy")
    file.write_bytes(b"no archive")
    assert_refused(ConfigError, "cannot be read", read_archive, file, "policy")
