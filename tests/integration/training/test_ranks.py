"""Several processes that learn together, with Gloo on a CPU: they stay equal, learn as one, leave together and go on."""

import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.config.storage import read_archive
from aerial_gym.rl_training import train
from aerial_gym.rl_training.ranks import ALONE
from aerial_gym.rl_training.run.run_folder import RunFolder
from tests.integration.training.ranks_worker import STEPS_OF_ONE, settings, train_ranks

LIMIT_S = 300.0  # After that a test takes two processes for hung; they need 20 s


def free_ports(count: int) -> list[str]:
    sockets = [socket.socket() for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [str(each.getsockname()[1]) for each in sockets]
    for each in sockets:
        each.close()
    return ports


def start_two(act: str, out: Path, *, ports: int) -> list[tuple[int, str]]:
    """Run two processes to their ends; return exit status and stderr of each."""
    actual = free_ports(ports)
    shared = os.environ | {
        "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": actual[-1], "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    command = [sys.executable, "-m", "tests.integration.training.ranks_worker", act, str(out), *actual]
    own = ({"RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in range(2))
    processes = [subprocess.Popen(command, env=shared | each, stderr=subprocess.PIPE, text=True) for each in own]
    try:
        return [(each.wait(LIMIT_S), each.stderr.read()) for each in processes]
    finally:
        for each in processes:
            each.kill()


@pytest.mark.slow
def test_two_processes_are_equal_bit_for_bit_and_learn_as_one(tmp_path: Path) -> None:
    """As one that flies the environments of both: but for the order of sums, which grows with every update of a flight.
    Adam divides by the size of a gradient, so that a weight with almost none moves by rounding alone: 0.1 and 1.1 % of
    the way were seen on two processors."""
    one, begun = (train_ranks(ALONE, iterations=count, like_one=True)["common"] for count in (2, 0))
    for status, said in start_two("learn", tmp_path, ports=2):
        assert status == 0, said
    for name in ("own", "one"):
        first, second = (torch.load(tmp_path / f"{name}_{rank}.pt") for rank in range(2))
        assert first["common"].keys() == second["common"].keys()
        for key, value in first["common"].items():
            assert torch.equal(value, second["common"][key]), key
        assert not torch.equal(first["seen"], second["seen"])
        assert first["env_steps"] == second["env_steps"] == 2 * STEPS_OF_ONE == int(first["common"]["sums"][0])
    both = torch.load(tmp_path / "one_0.pt")["common"]
    parts = ("actor.", "own_body.", "value_head.")
    weights = [key for key in one if key.startswith(parts) and ".normalizers." not in key]
    moved, apart = (torch.cat([(one[key] - of[key]).flatten() for key in weights]).norm() for of in (begun, both))
    assert apart < 0.05 * moved
    for key in one.keys() - set(weights):
        if not key.startswith("adam"):
            torch.testing.assert_close(both[key], one[key], atol=1e-4, rtol=1e-3)


@pytest.mark.slow
def test_two_processes_leave_together_go_on_bit_for_bit_and_in_another_number(tmp_path, caplog) -> None:
    alone = replace(settings(2), max_env_steps=STEPS_OF_ONE)
    train(alone, tmp_path / "more", show_progress=False)
    for status, said in start_two("resume", tmp_path, ports=4):
        assert status == 0, said
    whole, parts = (RunFolder(tmp_path / name).newest_readable_checkpoint() for name in ("whole", "parts"))
    assert whole[0].name == parts[0].name == f"checkpoint_{6 * STEPS_OF_ONE:015d}.pth"
    assert len(whole[1]["others"]) == 1
    assert_equal(whole[1], parts[1])
    assert "of 1 processes, and goes on with 2" in (tmp_path / "more" / "log.txt").read_text()
    more = RunFolder(tmp_path / "more").newest_readable_checkpoint()
    for payload in (whole[1], more[1]):
        for name in ("adam.mean", "adam.square", "adam.steps", "rate", "sums"):
            assert torch.equal(payload["learner"][name], payload["others"][0]["learner"][name]), name
    train(replace(alone, max_env_steps=7 * STEPS_OF_ONE), tmp_path / "parts", resume=True, show_progress=False)
    assert "of 2 processes, and goes on with 1" in caplog.text
    assert not read_archive(RunFolder(tmp_path / "parts").last_checkpoint(), "checkpoint")["others"]


@pytest.mark.slow
def test_two_processes_of_rl_games_have_equal_weights_and_continue(tmp_path: Path) -> None:
    """Its normalisers are each process's own: those of rank 0 are kept."""
    pytest.importorskip("rl_games", reason="rl-games is not installed: pip install 'aerial-gym[rl-games]'")
    for status, said in start_two("rl_games", tmp_path, ports=2):
        assert status == 0, said
    for save in range(2, 4):  # at the first, before the training, the library has not made them equal
        first, second = (torch.load(tmp_path / f"save_{save}_{rank}.pt") for rank in range(2))
        weights = [name for name in first if name.startswith("a2c_network.")]
        assert weights
        for name in weights:
            assert torch.equal(first[name], second[name]), name
    assert len(list(tmp_path.glob("save_*"))) == 2 * 3
    last = RunFolder(tmp_path / "run").newest_readable_checkpoint()
    assert last[1]["run"]["env_steps"] == last[1]["frame"] == 5 * 32 * 64
    assert len(last[1]["others"]) == 1


@pytest.mark.slow
def test_a_fault_in_one_process_ends_the_other_with_a_sentence(tmp_path: Path) -> None:
    (first, told), (second, fault) = start_two("fail", tmp_path, ports=1)
    assert (first, second) == (1, 1)
    assert "ValueError: a fault of rank 1" in fault
    assert "aerial-gym: rank 0: the processes of this training cannot go on together" in told
    assert "If another one has ended, its own message says why" in told


def assert_equal(first: object, second: object, where: str = "") -> None:
    """Compare nested mappings and sequences bit for bit. But for what depends on the clock, the tallies of a log, and
    for global random states, which nothing uses."""
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            if key not in ("random", "settings", "task.ended_tallies"):
                assert_equal(first[key], second[key], f"{where}/{key}")
    elif isinstance(first, list):
        for number, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_equal(one, other, f"{where}/{number}")
    elif isinstance(first, torch.Tensor):
        assert torch.equal(first, second), where
    else:
        assert first == second, where
