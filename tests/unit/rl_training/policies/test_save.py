"""Policies of other libraries as run folders: stand-ins of their learners here, the libraries in ``test_adapters``."""

from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor, nn

from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.rl_training import TRAINERS, load_policy, load_settings, save_policy, settings_for
from aerial_gym.rl_training.run.run_folder import RunFolder
from tests.refusals import assert_refused

TASK = "position_setpoint_task"


class Network(nn.Module):
    """A network as a user of skrl writes it."""

    def __init__(self, *, end: nn.Module | None = None, gain: float = 1.0) -> None:
        super().__init__()
        self.layers = nn.Sequential(nn.Linear(13, 8), nn.Tanh(), nn.Linear(8, 4), *([] if end is None else [end]))
        self.gain = gain

    def act(self, inputs: dict[str, Tensor], *, role: str) -> tuple[Tensor, dict[str, Tensor]]:
        mean = self.gain * self.layers(inputs["observations"])
        return mean + 1.0, {"mean_actions": mean}


class Scaler(nn.Module):
    """The formula of skrl's ``RunningStandardScaler``."""

    running_mean, running_variance = torch.linspace(-1.0, 1.0, 13), torch.linspace(1e-7, 4.0, 13)
    epsilon, clip_threshold = 1e-3, 2.0

    def forward(self, seen: Tensor) -> Tensor:
        scaled = (seen - self.running_mean) / (self.running_variance.sqrt() + self.epsilon)
        return scaled.clamp(-self.clip_threshold, self.clip_threshold)


class Agent:
    """An agent of skrl."""

    def __init__(self, network: nn.Module, scaler: Any = nn.Identity()) -> None:  # noqa: B008
        self.models, self._observation_preprocessor = {"policy": network}, scaler


Agent.__module__ = "skrl.agents.torch.ppo"


class Runner:
    """A runner of rsl_rl whose actor sees another group as well."""

    def __init__(self, network: nn.Module) -> None:
        network.obs_groups = ["observations", "images"]
        self.alg = SimpleNamespace(actor=network)


Runner.__module__ = "rsl_rl.runners"


@pytest.fixture(autouse=True)
def pretend_versions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(metadata, "version", lambda name: "1.0")


@pytest.mark.parametrize("scaler", [nn.Identity(), Scaler()])
def test_a_loaded_policy_flies_the_mean_action_of_the_network(scaler: nn.Module, tmp_path: Path) -> None:
    """Its normaliser has the library's own epsilon and limit."""
    network = Network()
    save_policy(Agent(network, scaler), tmp_path, task=TASK, robot="x500")
    policy, cfg = load_policy(tmp_path)
    assert (cfg.task, cfg.robot, cfg.trainer, cfg.source) == (TASK, "x500", "other_library", "skrl 1.0")
    seen = 3.0 * torch.randn(200, 13, generator=torch.Generator().manual_seed(1))
    expected = network.layers(scaler(seen)).clamp(-1.0, 1.0)
    torch.testing.assert_close(policy({"observations": seen}), expected.detach(), atol=1e-5, rtol=0.0)


def test_a_later_policy_replaces_an_earlier_one(tmp_path: Path) -> None:
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "checkpoints" / "agent_32.pt").write_text("a file of skrl")
    network = Network()
    save_policy(Agent(Network()), tmp_path, task=TASK)
    save_policy(Agent(network), tmp_path, task="tracking_task")
    policy, cfg = load_policy(tmp_path)
    assert torch.equal(policy.head.weight, network.layers[2].weight)
    assert cfg.task == "tracking_task"
    training = RunFolder(tmp_path / "training")
    training.create(load_settings(settings_for("ppo", TASK)))
    assert_refused(ConfigError, "holds a run already", save_policy, Agent(network), training.path, task=TASK)


def test_a_policy_that_is_another_function_is_refused_with_the_difference(tmp_path: Path) -> None:
    for learner, told in (
        (Agent(Network(gain=0.5)), r"policy of skrl: its actions are up to [\d.]+ from those of its linear layers"),
        (Agent(Network(end=nn.Tanh())), "its actions are up to"),
        (Agent(Network(end=nn.Softsign())), "it has Linear, Tanh, Softsign. It must be linear layers with one of"),
        (Agent(nn.Linear(13, 4)), "policy of skrl: it has Linear. It must be"),
        (Agent(None), "policy of skrl: Agent has no such network"),
        (Runner(Network()), "policy of rsl-rl-lib: its actor sees observations, images"),
        (Network(), "learner Network: must be an algorithm of Stable-Baselines3, an agent of skrl or a runner"),
    ):
        assert_refused(ConfigError, told, save_policy, learner, tmp_path / "run", task=TASK)
    assert_refused(UnknownNameError, "no task 'hover'", save_policy, Agent(Network()), tmp_path / "run", task="hover")
    assert not (tmp_path / "run").exists()


def test_such_a_run_cannot_be_trained(tmp_path: Path) -> None:
    save_policy(Agent(Network()), tmp_path, task=TASK)
    _, cfg = load_policy(tmp_path)
    assert_refused(ConfigError, "trainer other_library: trains nothing", TRAINERS.get(cfg.trainer).check, cfg)
    assert_refused(ConfigError, "trainer other_library: has no settings for", settings_for, cfg.trainer, TASK)
