"""What only a GPU shows: a training is a graph, and goes on from a checkpoint as it would have gone on."""

import socket
from dataclasses import replace

import pytest
import torch

from aerial_gym.rl_training.learning.distill import Distill
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.load import make_network
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.rl_training.ranks import ALONE, Ranks, join_ranks
from aerial_gym.rl_training.trainers.learners import PpoTrainer
from aerial_gym.rl_training.trainers.native import LOOK_EVERY, NativeTraining
from aerial_gym.task import task_registry
from tests.unit.rl_training.learning.test_apg import student_settings as distillation
from tests.unit.rl_training.learning.test_ppo import settings

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")


@pytest.mark.parametrize(
    ("fused", "memory"), [(True, 0), (False, 0), (False, 16)], ids=["kernels", "operations", "recurrent"]
)
def test_a_training_on_a_gpu_is_a_graph_that_repeats_and_continues(fused: bool, memory: int) -> None:
    """With one seed the same, and after a checkpoint too, but for the order in which a GPU sums. A rounding of the last
    bit grows with every update of a flight: the bound is on the weights after 16 iterations, which move by 0.01
    each."""
    cfg = replace(settings(256, hidden_layers=(32, 32), memory=memory), device="cuda")

    def train(looks: int, state: dict[str, object] | None = None) -> tuple[dict[str, object], float]:
        with task_registry.make_task(cfg.task, num_envs=256, device="cuda", seed=0, capture=False) as task:
            training = PpoTrainer().make_training(cfg, task, fused=fused)
            if state is not None:
                training.load(state)
            for _ in range(looks):
                training.advance()
            assert training._repeat.is_captured
            assert type(training.learner).__name__ == ("FusedPpo" if fused else "Ppo")
            return training.state(), float(training.learner.sums[0])

    whole, steps = train(2)
    assert steps == 2 * LOOK_EVERY * cfg.ppo.horizon * 256  # the device counts what the host does
    again, _ = train(2)
    first, _ = train(1)
    second, _ = train(1, first)
    for other in (again, second):
        for name, tensor in whole["model"].items():
            torch.testing.assert_close(other["model"][name], tensor, atol=1e-3, rtol=1e-3, msg=name)


def test_a_training_that_talks_by_nccl_is_a_graph_and_learns_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    cfg = replace(settings(256, hidden_layers=(32, 32)), device="cuda")

    def train(ranks: Ranks) -> dict[str, torch.Tensor]:
        with task_registry.make_task(cfg.task, num_envs=256, device="cuda", seed=0, capture=False) as task:
            training = PpoTrainer().make_training(cfg, task, ranks=ranks)
            training.advance()
            assert training._repeat.is_captured
            return training.state()["model"]

    alone = train(ALONE)
    variables = {"RANK": "0", "LOCAL_RANK": "0", "WORLD_SIZE": "1", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with join_ranks("cuda") as ranks:
        assert (ranks.size, ranks.joined) == (1, True)
        told = train(ranks)
    for name, tensor in alone.items():
        torch.testing.assert_close(told[name], tensor, atol=1e-3, rtol=1e-3, msg=name)


@pytest.mark.parametrize("memory", [0, 16])
def test_a_distillation_is_a_graph(memory: int) -> None:
    cfg = replace(distillation(256, memory=memory, learning_rate=5e-3), device="cuda", max_env_steps=10**6)
    seen = NetworkBodyCfg(shapes={"observations": (13,)}, hidden_layers=(16,), memory=memory)
    with task_registry.make_task(cfg.task, num_envs=256, device="cuda", seed=0, capture=False) as task:
        teacher = Policy(seen, task.num_actions).to("cuda").requires_grad_(False)
        training = NativeTraining(cfg, task, Distill(cfg, task, make_network(cfg, task), teacher))
        training.advance()
        first = training.gauges()["difference"]
        for _ in range(10):
            training.advance()
        assert training._repeat.is_captured
        assert training.gauges()["difference"] < first
