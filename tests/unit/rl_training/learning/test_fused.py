"""The learner in kernels of its own against the one in torch operations: on a GPU, or in Triton's interpreter.
``TRITON_INTERPRET=1 python -m pytest tests/unit/rl_training/learning/test_fused.py`` runs it without a GPU."""

import os
from dataclasses import replace

import pytest
import torch

pytest.importorskip("triton", reason="triton is not installed: it comes with torch for CUDA")
if not torch.cuda.is_available() and os.environ.get("TRITON_INTERPRET") != "1":
    pytest.skip("needs a GPU, or TRITON_INTERPRET=1", allow_module_level=True)

from aerial_gym.rl_training.learning.fused import FusedPpo, fusion_refusal
from aerial_gym.rl_training.learning.ppo import Ppo
from aerial_gym.rl_training.policies.load import make_network
from aerial_gym.task import task_registry
from tests.unit.rl_training.learning.test_ppo import settings

DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
# On a GPU products of the pass backward have 10 bits, and sums another order.
RELATIVE = 5e-3 if DEVICE == "cuda" else 2e-5


@pytest.mark.parametrize("activation", ["elu", "relu", "tanh"])
@pytest.mark.parametrize("clip_value", [False, True])
@pytest.mark.parametrize("critic", [(), ("critic",), ("observations", "critic")], ids=["alike", "other", "more"])
def test_gradient_values_and_actions_are_those_of_torch(activation, clip_value, critic) -> None:
    name = "position_setpoint_task_sim2real" if critic else "position_setpoint_task"
    sizes = {"critic_keys": critic, "horizon": 8, "hidden_layers": (16, 16), "num_minibatches": 2, "head_variance": 1.0}
    kind = {"activation": activation, "clip_value": clip_value, "normalize_observation": True}
    cfg = settings(24, **sizes, **kind, entropy_coef=1e-2, bound_coef=0.1, max_grad_norm=1e9)
    cfg = replace(cfg, task=name, device=DEVICE)
    result = {}
    with task_registry.make_task(cfg.task, num_envs=24, device=DEVICE, seed=0, capture=False) as task:
        network = make_network(cfg, task)
        torch.nn.init.normal_(network.value_head.weight, std=0.5, generator=torch.Generator(DEVICE).manual_seed(1))
        plain = Ppo(cfg, task, network)
        plain.restart_episodes()
        with torch.no_grad():
            flown = plain._simulate_segment()
            samples = plain._segment_samples(flown)
            old_log_std = network.actor.log_std.clone()
        fused = FusedPpo(cfg, task, network)
        nudge = torch.randn(fused._adam.weights.shape, generator=torch.Generator().manual_seed(2))
        fused._adam.weights.add_(0.1 * nudge.to(DEVICE))
        chosen = torch.randperm(24, generator=torch.Generator().manual_seed(3)).to(DEVICE)[:11]
        ratio = network.sequence_outputs(samples.prepared, samples.memory, samples.in_time["begins"])[0]
        ratio = (ratio.log_prob(samples.in_time["action"]) - samples.in_time["log_prob"]).exp()
        assert float((ratio > 1.2).float().mean()) > 0.1
        assert float((ratio < 0.8).float().mean()) > 0.1
        noise = torch.randn(24, task.num_actions, generator=torch.Generator().manual_seed(4)).to(DEVICE)
        observation = {key: value[0] for key, value in flown.observation.items()}
        with torch.no_grad():
            prepared = network.network_inputs(flown.observation)
            final = network.network_inputs(flown.final)
        for name, learner in (("plain", plain), ("fused", fused)):
            seen = fused._samples_as_vectors(samples) if learner is fused else samples
            gradient = learner._loss_gradient(seen, chosen, old_log_std)
            with torch.no_grad():
                acts = learner._draw_action_and_command(observation, flown.memory, flown.begins[0], noise)[:3]
                values = learner._segment_values(prepared, final, flown)[:2]
            result[name] = {
                "gradient": gradient[0].detach(), "numbers": gradient[1].detach(),
                **dict(zip(("mean", "action", "command"), acts, strict=True)),
                **dict(zip(("values", "finals"), values, strict=True)),
            }  # fmt: skip
    for name, expected in result["plain"].items():
        size = float(expected.abs().max())
        assert size > 0.0, name
        torch.testing.assert_close(result["fused"][name], expected, atol=RELATIVE * size, rtol=0.0, msg=name)


def test_what_does_not_fit_into_kernels_is_told() -> None:
    cfg = settings(8, hidden_layers=(24, 24))
    with task_registry.make_task(cfg.task, num_envs=8, device="cpu", seed=0, capture=False) as task:
        network = make_network(cfg, task)
        assert fusion_refusal(cfg.ppo, network, torch.device("cpu")) == "no GPU"
        assert "16, 32, 64" in str(fusion_refusal(cfg.ppo, network, torch.device("cuda")))
        ppo = replace(cfg.ppo, separate_value_network=False)
        assert "share layers" in str(fusion_refusal(ppo, network, torch.device("cuda")))
        assert fusion_refusal(settings().ppo, network, torch.device("cuda")) is None
