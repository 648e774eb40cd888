"""A loaded policy against the networks of the libraries, and the figures of an evaluation against a scripted flight."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
from gymnasium.spaces import Box

from aerial_gym.errors import ConfigError, MissingDependencyError, UnknownNameError
from aerial_gym.rl_training import TRAINERS, evaluate, load_policy, load_settings, settings_for
from aerial_gym.rl_training.policies.load import check_fits, policy_from_payload
from aerial_gym.rl_training.settings import TRAINING_CONFIGS, TrainingCfg
from aerial_gym.task import task_registry
from tests.refusals import assert_refused

NETWORKS = [(separate, normalize) for separate in (False, True) for normalize in (False, True)]


def settings(trainer: str, *, separate: bool, normalize: bool) -> TrainingCfg:
    cfg = load_settings(settings_for(trainer, "position_setpoint_task"))
    kind = {"separate_value_network": separate, "normalize_observation": normalize, "head_variance": 9.0}
    return replace(cfg, ppo=replace(cfg.ppo, hidden_layers=(16, 8), **kind), num_envs=8, device="cpu")


def randomize_(state: dict[str, torch.Tensor]) -> None:
    """Give the running statistics values that a training could have left."""
    generator = torch.Generator().manual_seed(1)
    for key, value in state.items():
        if key.endswith(("running_mean", "running_var")):
            value.copy_(0.5 + torch.rand(value.shape, generator=generator, dtype=value.dtype))


@pytest.mark.parametrize(("separate", "normalize"), NETWORKS)
def test_policy_is_the_mean_action_of_the_rl_games_network(separate: bool, normalize: bool, tmp_path: Path) -> None:
    pytest.importorskip("rl_games", reason="rl-games is not installed")
    from rl_games.algos_torch.model_builder import ModelBuilder

    from aerial_gym.rl_training.adapters.rl_games import TaskVecEnv, library_params

    cfg = settings("rl_games", separate=separate, normalize=normalize)
    with task_registry.make_task(cfg.task, num_envs=8, device="cpu") as task:
        params = library_params(cfg, TaskVecEnv(task), tmp_path, device="cpu")
    sizes = {"actions_num": 4, "input_shape": (13,), "num_seqs": 8, "normalize_value": True}
    model = ModelBuilder().load(params).build(sizes | {"normalize_input": normalize})
    randomize_(model.state_dict())
    model.eval()
    observation = 3.0 * torch.randn(32, 13, generator=torch.Generator().manual_seed(0))
    expected = model({"is_train": False, "obs": observation.clone()})["mus"].clamp(-1.0, 1.0)
    policy = policy_from_payload({"model": model.state_dict()}, cfg, where="test")
    torch.testing.assert_close(policy({"observations": observation}), expected.detach(), atol=1e-6, rtol=1e-6)
    assert 0.01 < float((expected.abs() == 1.0).float().mean()) < 0.99  # some are clamped and some are not


@pytest.mark.parametrize(("separate", "normalize"), NETWORKS)
def test_policy_is_the_mean_action_of_the_sample_factory_network(separate, normalize, tmp_path) -> None:
    pytest.importorskip("sample_factory", reason="Sample Factory is not installed")
    from sample_factory.algo.utils.rl_utils import prepare_and_normalize_obs
    from sample_factory.model.actor_critic import create_actor_critic

    from aerial_gym.rl_training.adapters.sample_factory import TaskBatchedEnv, library_config

    cfg = settings("sample_factory", separate=separate, normalize=normalize)
    with task_registry.make_task(cfg.task, num_envs=8, device="cpu") as task:
        env = TaskBatchedEnv(task)
    library_cfg = library_config(cfg, tmp_path, env_name="test", device=torch.device("cpu"))
    model = create_actor_critic(library_cfg, env.observation_space, env.action_space)
    randomize_(model.state_dict())
    torch.nn.init.normal_(model.action_parameterization.distribution_linear.weight, std=1.0)
    model.eval()
    observation = 3.0 * torch.randn(32, 13, generator=torch.Generator().manual_seed(0))
    normalized = prepare_and_normalize_obs(model, {"obs": observation.clone()})
    model(normalized, torch.zeros(32, 1 + separate))
    expected = model.action_distribution().means.clamp(-1.0, 1.0)
    policy = policy_from_payload({"model": model.state_dict()}, cfg, where="test")
    torch.testing.assert_close(policy({"observations": observation}), expected.detach(), atol=1e-6, rtol=1e-6)


FAST_CRASH = ("task.terminations.far_away.params.distance=1.5", "task.episode_len_steps=200")


class ScriptPilot:
    """A function that flies, and what it was told to forget."""

    def __init__(self, function: Callable[[Mapping[str, torch.Tensor]], torch.Tensor]) -> None:
        self.function, self.forgot = function, []

    def __call__(self, observation: Mapping[str, torch.Tensor]) -> torch.Tensor:
        return self.function(observation)

    def reset(self, mask: torch.Tensor | None = None) -> None:
        self.forgot.append(None if mask is None else int(mask.sum()))


class Clock(NamedTuple):
    dt: float


class ScriptTask:
    """Four flights of 3 s at 2 steps a second, with distances that are known."""

    cfg = replace(task_registry.get("position_setpoint_task"), episode_len_steps=6)
    env = Clock(dt=0.5)
    num_envs, device, tallies = 4, torch.device("cpu"), torch.zeros(4, 1)
    distances = torch.tensor(
        [
            [0.9, 0.05, 0.9, 0.05, 0.04, 0.02],  # in, out again, and back after step 3: settles at 1.5 s, error 0.03
            [0.9, 0.8, 0.7, 0.6, 0.3, 0.1],  # too slow: error 0.2
            [0.9, 9.0, 0.0, 0.0, 0.0, 0.0],  # crashes in step 2; what follows is another episode
            [0.01, 0.01, 0.01, 0.01, 0.01, 0.01],  # was there all the time: settles at 0 s, error 0.01
        ]
    )

    def reset(self) -> tuple[dict[str, torch.Tensor], dict[str, torch.Tensor]]:
        self.step_count = 0
        return {"observations": torch.zeros(4, 2)}, {}

    def means_of_tallies(self, tallies: torch.Tensor) -> dict[str, float]:
        return {}

    def step(self, actions: torch.Tensor):
        assert actions.shape == (4, 1)
        distance = self.distances[:, self.step_count]
        self.step_count += 1
        crash = distance > 8.0
        info = {"distance": distance, "crashes": crash}
        return {"observations": torch.zeros(4, 2)}, torch.ones(4), crash, torch.zeros_like(crash), info


def test_evaluation_of_known_flights() -> None:
    seen = []
    pilot = ScriptPilot(lambda obs: obs["observations"][:, :1])
    result = evaluate(pilot, ScriptTask(), on_step=lambda step, steps: seen.append((step, steps)))
    assert pilot.forgot == [None, 0, 1, 0, 0, 0, 0]  # all at the start, then the row that crashed
    assert seen == [(i, 6) for i in range(1, 7)]
    assert (result.num_starts, result.episode_s) == (4, 3.0)
    assert (result.crash_rate, result.success_rate) == (pytest.approx(1 / 4), pytest.approx(2 / 4))
    assert result.final_error_mean_m == pytest.approx((0.03 + 0.2 + 0.01) / 3)
    assert (result.final_error_max_m, result.settled_rate) == (pytest.approx(0.2), pytest.approx(2 / 4))
    assert result.settling_time_mean_s == pytest.approx((1.5 + 0.0) / 2)
    assert result.return_mean == pytest.approx((6 + 6 + 2 + 6) / 4)


def test_evaluation_of_a_race_tells_gates_and_times() -> None:
    gates = torch.tensor([[1, 0, 1, 0, 1, 1], [1, 1, 0, 0, 0, 0], [0, 0, 1, 1, 1, 1], [0] * 6]).bool()
    done, crash = torch.zeros(4, 6, dtype=torch.bool), torch.zeros(4, 6, dtype=torch.bool)
    done[0, 2], done[0, 4], done[1, 1], crash[2, 1] = True, True, True, True  # after 1.5 s and 1 s; a crash after 1 s

    class Race(ScriptTask):
        cfg = replace(task_registry.get("racing_task"), episode_len_steps=6)

        def step(self, actions: torch.Tensor):
            k = self.step_count
            obs, reward, *_ = super().step(actions)
            told = {"successes": done[:, k], "crashes": crash[:, k], "gate_passed": gates[:, k]}
            return obs, reward, done[:, k] | crash[:, k], torch.zeros(4, dtype=torch.bool), told

    result = evaluate(ScriptPilot(lambda obs: obs["observations"][:, :1]), Race())
    assert (result.success_rate, result.crash_rate, result.timeout_rate) == (0.5, 0.25, 0.25)
    assert result.gates_passed_mean == pytest.approx((2 + 2 + 0 + 0) / 4)
    assert result.success_time_mean_s == pytest.approx((1.5 + 1.0) / 2)


def test_a_task_without_a_target_has_returns_alone() -> None:
    class Aimless(ScriptTask):
        def step(self, actions: torch.Tensor):
            *rest, info = super().step(actions)
            return *rest, {"crashes": info["crashes"]}

    result = evaluate(ScriptPilot(lambda obs: obs["observations"][:, :1]), Aimless())
    assert (result.final_error_mean_m, result.settling_time_mean_s) == (None, None)
    assert (result.gates_passed_mean, result.success_time_mean_s) == (None, None)
    assert (result.settled_rate, result.success_rate) == (0.0, 0.0)
    assert (result.crash_rate, result.return_mean) == (pytest.approx(1 / 4), pytest.approx((3 * 6 + 2) / 4))


def test_an_evaluation_states_the_terms_and_ends_of_the_first_episodes() -> None:
    """An environment that crashes flies on in a second episode, which does not count."""
    with task_registry.make_task("position_setpoint_task", num_envs=8, device="cpu", settings=FAST_CRASH) as task:
        climb = ScriptPilot(lambda obs: torch.full((8, task.num_actions), 1.0))
        result = evaluate(climb, task)
        assert task.episode_means()["episodes"] > 8
    assert set(result.reward_terms) == set(task.reward_names)
    assert sum(result.reward_terms.values()) == pytest.approx(result.return_mean, rel=1e-5)
    assert result.reward_terms["crash"] == -20.0 * result.crash_rate
    assert result.ended_by == {"contact": 0.0, "far_away": 1.0, "time_out": 0.0}


def test_a_policy_that_is_not_there_or_elsewhere_is_refused(tmp_path: Path) -> None:
    assert_refused(ConfigError, "holds no checkpoint", load_policy, tmp_path)
    assert_refused(ConfigError, "no such file", load_policy, tmp_path / "policy.pth")
    (tmp_path / "policy.pth").write_bytes(b"no checkpoint")
    assert_refused(ConfigError, "no config.yaml in the folders above it", load_policy, tmp_path / "policy.pth")
    cfg = settings("rl_games", separate=True, normalize=False)
    assert_refused(ConfigError, "is no rl_games checkpoint", policy_from_payload, {"model": {}}, cfg, where="test")
    assert_refused(ConfigError, r"is on meta, the task", evaluate, torch.nn.Linear(2, 1, device="meta"), ScriptTask())


def test_impossible_settings_and_missing_trainers_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = settings("rl_games", separate=True, normalize=False)
    assert_refused(UnknownNameError, "'cleanrl'. Known: apg", settings_for, "cleanrl", "position_setpoint_task")
    for own, changes, message in (
        (cfg, {"max_time_s": None, "max_env_steps": None}, "or the training never ends"),
        (cfg, {"ppo": replace(cfg.ppo, num_minibatches=7)}, "cannot be split into num_minibatches = 7"),
        (cfg.ppo, {"discount": 1.0}, r"PpoCfg.discount = 1.0: must be between 0 and 1"),
        (cfg.ppo, {"learning_rate": float("nan")}, r"PpoCfg.learning_rate = nan: must be > 0"),
    ):
        assert_refused(ConfigError, message, replace, own, **changes)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    told = r"trainer 'sample_factory' needs .* pip install 'aerial-gym\[sample-factory\]'"
    assert_refused(MissingDependencyError, told, TRAINERS.get("sample_factory").require)


def test_a_policy_that_diverged_or_was_trained_for_another_task_is_refused() -> None:
    cfg = settings("rl_games", separate=True, normalize=False)
    shapes = {"actor_mlp.0.weight": (16, 13), "actor_mlp.0.bias": (16,), "actor_mlp.2.weight": (8, 16)}
    shapes |= {"actor_mlp.2.bias": (8,), "mu.weight": (4, 8), "mu.bias": (4,)}
    state = {f"a2c_network.{name}": torch.zeros(shape) for name, shape in shapes.items()}
    policy = policy_from_payload({"model": state}, cfg, where="test")
    with task_registry.make_task(cfg.task, num_envs=2, device="cpu") as task:
        check_fits(policy, task, cfg.task)
        task.observation_space["observations"] = Box(-1.0, 1.0, (78,))
        told = "takes 13 observations and gives 4 actions; this task has 78 observations and 4"
        assert_refused(ConfigError, told, check_fits, policy, task, cfg.task)
    state["a2c_network.mu.bias"] = torch.tensor([0.0, float("nan"), 0.0, 0.0])
    assert_refused(ConfigError, "test: layer 2 holds 1", policy_from_payload, {"model": state}, cfg, where="test")


def test_every_file_of_settings_can_be_read_and_a_cpu_has_some_of_its_own() -> None:
    for path in sorted(TRAINING_CONFIGS.glob("*.yaml")):
        cfg = load_settings(path)
        assert path.stem.startswith(cfg.trainer), path.stem
        task_registry.get(cfg.task)
    tasks = ("position_setpoint_task", "navigation_task", "a_task_without")
    for trainer in ("ppo", "rl_games"):
        names = [settings_for(trainer, task, device="cpu").name.removeprefix(f"{trainer}_") for task in tasks]
        assert names == ["position_setpoint_cpu.yaml", "navigation.yaml", "position_setpoint_cpu.yaml"]
    for name in ("safe_navigation", "lidar_navigation"):
        fewer = load_settings(settings_for("ppo", f"{name}_task", device="cpu")).num_envs
        assert fewer < load_settings(TRAINING_CONFIGS / f"ppo_{name}.yaml").num_envs
