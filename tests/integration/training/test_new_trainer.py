"""A trainer that only this file knows, a random search: commands train, resume, evaluate, play and list it by its name."""

import json
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from aerial_gym.cli.main import main
from aerial_gym.config.checks import require_positive
from aerial_gym.errors import ConfigError, MissingDependencyError
from aerial_gym.rl_training import TRAINERS, Policy, Trainer, load_policy, load_settings, train
from aerial_gym.rl_training.learner_settings import LearnerCfg
from aerial_gym.rl_training.policies.load import body_cfg
from aerial_gym.rl_training.run.progress import Report
from aerial_gym.rl_training.run.run_folder import RunFolder
from tests.refusals import assert_refused

SETTINGS = """
task: position_setpoint_task
trainer: random_search
num_envs: 16
device: cpu
max_env_steps: 640
numbers: {hidden_layers: [8], horizon: 10, normalize_observation: false, sigma: 0.05}
source: test
"""


@dataclass(frozen=True, kw_only=True)
class SearchCfg(LearnerCfg):
    """Numbers of the search."""

    sigma: float  # Standard deviation of a step of the weights, > 0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "sigma")


class RandomSearch(Trainer):
    """Keeps a random step of the weights if the next steps of the task give more reward."""

    name = "random_search"
    summary = "a random search over the weights"
    section, settings = "numbers", SearchCfg

    def run(self, run):
        cfg, task, keeper = run.cfg, run.task, run.keeper
        search = cfg.section(SearchCfg)
        policy = Policy(body_cfg(cfg, {"observations": (13,)}), 4)
        self.env_steps, best = 0, -torch.inf
        if keeper.resumes:
            keeper.restore(lambda state: self._load(policy, state))
        observation, _ = task.reset()
        done = False
        while not done:
            kept = {name: weights.clone() for name, weights in policy.state_dict().items()}
            for weights in policy.parameters():
                weights.data += search.sigma * torch.randn_like(weights)
            total = 0.0
            for _ in range(search.horizon):
                run.interruption.check()
                observation, reward, *_ = task.step(policy(observation))
                total += float(reward.mean())
            if total < best:
                policy.load_state_dict(kept)
            best = max(best, total)
            self.env_steps += search.horizon * task.num_envs
            done = run.progress.update(Report(env_steps=self.env_steps, episode_return=total, episode_length=None))
        model = {f"actor.{name}": weights for name, weights in policy.state_dict().items()}
        network = {"shapes": {"observations": [13]}, "num_actions": 4}
        keeper.save({"model": model, "network": network, "env_steps": self.env_steps}, env_steps=self.env_steps)
        return False

    def _load(self, policy, state):
        policy.load_state_dict({name.removeprefix("actor."): weights for name, weights in state["model"].items()})
        self.env_steps = state["env_steps"]


@pytest.fixture(autouse=True)
def register_search(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TRAINERS._entries, RandomSearch.name, RandomSearch())


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    file = tmp_path / "search.yaml"
    file.write_text(SETTINGS, encoding="utf-8")
    return file


def test_commands_train_resume_evaluate_and_play_a_new_trainer(settings, tmp_path, capsys) -> None:
    out, table = tmp_path / "run", tmp_path / "flights.csv"
    assert main(["train", "--trainer", "random_search", "--config", str(settings), "--out", str(out), "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert (first["trainer"], first["env_steps"]) == ("random_search", 640)
    assert RunFolder(out).config().section(SearchCfg).sigma == 0.05
    assert main(["train", "--out", str(out), "--resume", "--max-env-steps", "960", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["env_steps"] == 960
    assert main(["evaluate", "--policy", str(out), "--num-envs", "4", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["num_starts"] == 4
    assert main(["play", "--policy", str(out), "--num-steps", "2", "--out", str(table)]) == 0
    assert len(table.read_text().splitlines()) == 1 + 3 * 4
    assert main(["export", "--policy", str(out), "--to", "torchscript", "--no-check"]) == 0
    assert list((out / "export").glob("*.pt"))


def test_the_list_holds_a_new_trainer(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "trainers", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["trainers"]["random_search"] == RandomSearch.summary


def test_a_library_call_trains_it_as_well(settings: Path, tmp_path: Path) -> None:
    result = train(load_settings(settings), tmp_path / "run", show_progress=False)
    policy, cfg = load_policy(tmp_path / "run")
    assert (result.env_steps, policy.num_actions, cfg.learner.horizon) == (640, 4, 10)


def test_wrong_settings_and_a_missing_library_are_named(
    settings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings.write_text(SETTINGS.replace("sigma: 0.05", "sigma: -1.0"), encoding="utf-8")
    assert_refused(ConfigError, "SearchCfg.sigma = -1.0", load_settings, settings)
    settings.write_text(SETTINGS.replace("sigma: 0.05", "sgma: 0.05"), encoding="utf-8")
    assert_refused(ConfigError, "unknown field 'sgma'. Did you mean 'sigma'", load_settings, settings)
    settings.write_text(SETTINGS, encoding="utf-8")
    monkeypatch.setattr(RandomSearch, "package", "no_such_search")
    with pytest.raises(
        MissingDependencyError, match="'random_search' needs no_such_search: pip install no_such_search"
    ):
        train(load_settings(settings), tmp_path / "run", show_progress=False)
    assert not (tmp_path / "run").exists()
