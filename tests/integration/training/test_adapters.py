"""Tasks as skrl, rsl_rl and Stable-Baselines3 see them, beside the same task as it is; the examples that train with them."""

import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry
from aerial_gym.cli.main import main
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import load_policy, save_policy
from tests.refusals import assert_refused

ENVS, STEPS = 64, 24  # Enough for episodes to end by their length: each of 500 steps at a random age

EXAMPLES = Path(__file__).parents[3] / "examples" / "other_libraries"


def library(name: str, extra: str) -> ModuleType:
    """Return the adapter of a library that is installed."""
    pytest.importorskip(name, reason=f"{name} is not installed: pip install 'aerial-gym[{extra}]'")
    return importlib.import_module(f"aerial_gym.rl_training.adapters.{name}")


EXTRAS = {"skrl": "skrl", "rsl_rl": "rsl-rl", "stable_baselines3": "sb3"}


def make() -> Task:
    return task_registry.make_task("position_setpoint_task", num_envs=ENVS, device="cpu", seed=4)


def as_captured(task: Task) -> Task:
    """Let every step write into the tensors of the first one, as a CUDA graph does."""
    step, kept = task.step, {}

    def write(place: str, value: Any) -> Any:
        if isinstance(value, dict):
            return {name: write(f"{place}/{name}", inner) for name, inner in value.items()}
        if isinstance(value, tuple):
            return tuple(write(f"{place}/{number}", inner) for number, inner in enumerate(value))
        return kept.setdefault(place, value.clone()).copy_(value)

    task.step = lambda actions: write("", step(actions))
    return task


def reference_steps() -> Iterator[tuple[Tensor, dict[str, Tensor], Tensor, Tensor, Tensor, dict[str, Tensor]]]:
    """Give each action, and what the task alone answers: in the first half many crash."""
    task = make()
    observation, _ = task.reset()
    task.stagger()
    yield torch.empty(0), {"observations": observation["observations"].clone()}, *(torch.empty(0),) * 3, {}
    generator = torch.Generator().manual_seed(1)
    for step in range(STEPS):
        actions = 2.0 * torch.rand(ENVS, task.num_actions, generator=generator) - 1.0
        actions = actions * (step < STEPS // 2)
        yield actions, *task.step(actions)


def test_skrl_gets_columns_and_keeps_what_it_was_given() -> None:
    env = library("skrl", "skrl").SkrlEnv(as_captured(make()), state="observations")
    script = reference_steps()
    assert (env.num_envs, env.observation_space) == (ENVS, env.state_space)
    observation, _ = env.reset()
    assert torch.equal(observation, next(script)[1]["observations"])
    ended = torch.zeros(2)
    for actions, seen, reward, terminated, truncated, _ in script:
        before = observation.clone()
        kept = observation
        observation, *columns, _ = env.step(actions)
        assert torch.equal(kept, before)
        assert torch.equal(observation, seen["observations"])
        assert torch.equal(env.state(), observation)
        for column, expected in zip(columns, (reward, terminated, truncated), strict=True):
            assert torch.equal(column, expected[:, None])
        ended += torch.stack((terminated.sum(), truncated.sum()))
    assert ended[1] > 0


def make_formation(num_envs: int = 4) -> Task:
    return task_registry.make_task(
        "formation_task", num_envs=num_envs, device="cpu", seed=4, settings=["task.episode_len_steps=20"]
    )


def test_skrl_gets_an_agent_for_each_vehicle() -> None:
    env = library("skrl", "skrl").SkrlVehiclesEnv(as_captured(make_formation()), state="critic")
    task = make_formation()
    expected, _ = task.reset()
    task.stagger()
    observation, _ = env.reset()
    assert (env.num_envs, env.num_agents, list(observation)) == (4, 3, [f"vehicle_{number}" for number in range(3)])
    ended = 0
    for step in range(20):
        rows = torch.sin(torch.arange(48.0) + step).view(4, 3, 4)
        for number, name in enumerate(env.possible_agents):
            assert torch.equal(observation[name], expected["observations"].view(4, 3, -1)[:, number])
            assert torch.equal(
                env.state()[name] if step else observation[name],
                (expected["critic" if step else "observations"].view(4, 3, -1)[:, number]),
            )
        actions = {name: rows[:, number] for number, name in enumerate(env.possible_agents)}
        observation, reward, terminated, truncated, _ = env.step(actions)
        expected, *columns, _ = task.step(rows.view(12, 4))
        for told, column in zip((reward, terminated, truncated), columns, strict=True):
            assert torch.equal(torch.cat(list(told.values()), dim=1), column.view(4, 3))
        ended += int(truncated["vehicle_0"].sum())
    assert ended == 4


def test_pettingzoo_passes_its_own_test() -> None:
    adapter = library("pettingzoo", "pettingzoo")
    from pettingzoo.test import parallel_api_test  # pyright: ignore[reportMissingImports]

    env = adapter.VehiclesParallelEnv(make_formation(1), state="critic")
    parallel_api_test(env, num_cycles=30)
    first, _ = env.reset(seed=3)
    again, _ = env.reset(seed=3)
    assert all((first[name] == again[name]).all() for name in env.possible_agents)
    assert env.state().shape == env.state_space.shape == (3 * 28,)
    for _ in range(20):
        seen, _, terminated, truncated, _ = env.step({name: env.action_space(name).sample() for name in env.agents})
    assert all(truncated.values()) or all(terminated.values())
    assert not env.agents
    assert (
        abs(seen["vehicle_0"][:3] - first["vehicle_0"][:3]).max() > 1e-3
    )  # the last of the episode, not the next start
    with pytest.raises(ConfigError, match="num_envs = 2: must be 1"):
        adapter.VehiclesParallelEnv(make_formation(2))


def test_rsl_rl_gets_time_outs_and_a_dictionary_of_groups() -> None:
    env = library("rsl_rl", "rsl-rl").RslRlEnv(as_captured(make()))
    script = reference_steps()
    assert torch.equal(env.get_observations()["observations"], next(script)[1]["observations"])
    assert env.max_episode_length == 500
    ended = torch.zeros(2)
    for actions, seen, reward, terminated, truncated, _ in script:
        kept = env.get_observations()["observations"]
        before = kept.clone()
        observation, rewards, dones, extras = env.step(actions)
        assert torch.equal(kept, before)
        assert torch.equal(observation["observations"], seen["observations"])
        assert torch.equal(rewards, reward)
        assert torch.equal(dones, terminated | truncated)
        assert torch.equal(extras["time_outs"], truncated)
        ended += torch.stack((terminated.sum(), truncated.sum()))
    assert ended[1] > 0
    env.episode_length_buf = torch.full((ENVS,), 7)
    assert env.episode_length_buf.tolist() == [7] * ENVS


def test_stable_baselines3_gets_the_last_observation_of_an_episode() -> None:
    env = library("stable_baselines3", "sb3").Sb3Env(as_captured(make()))
    script = reference_steps()
    observation = env.reset()
    assert (observation == next(script)[1]["observations"].numpy()).all()
    ended = 0
    for actions, seen, reward, terminated, truncated, info in script:
        kept, before = observation, observation.copy()
        observation, rewards, dones, infos = env.step(actions.numpy())
        assert (kept == before).all()
        assert (observation == seen["observations"].numpy()).all()
        assert (rewards == reward.numpy()).all()
        assert (dones == (terminated | truncated).numpy()).all()
        for row, told in enumerate(infos):
            assert bool(told) == bool(dones[row])
            if told:
                assert (told["terminal_observation"] == info["final_observation"][row].numpy()).all()
                assert told["TimeLimit.truncated"] == bool(truncated[row])
                episode = {"r": float(info["episode_return"][row]), "l": int(info["episode_length"][row])}
                assert told["episode"] == episode
                ended += told["TimeLimit.truncated"]
    assert ended > 0
    assert (env.env_is_wrapped(object), env.get_attr("num_envs", [0, 1])) == ([False] * ENVS, [ENVS] * 2)


@pytest.mark.parametrize(("name", "extra"), EXTRAS.items())
def test_the_examples_train(name: str, extra: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    library(name, extra)
    spec = importlib.util.spec_from_file_location(f"with_{name}", EXAMPLES / f"with_{name}.py")
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    example.main(num_envs=32, iterations=2, device="cpu", out=tmp_path / "run")
    assert "mean distance [m]" in capsys.readouterr().out
    run, table = str(tmp_path / "run"), tmp_path / "flights.csv"
    assert main(["evaluate", "--policy", run, "--num-envs", "4", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["num_starts"] == 4
    assert main(["play", "--policy", run, "--num-steps", "2", "--out", str(table)]) == 0
    assert len(table.read_text().splitlines()) == 1 + 3 * 4
    assert main(["export", "--policy", run, "--to", "torchscript"]) == 0  # compared with torch


@pytest.mark.parametrize("normalize", [False, True])
def test_a_policy_of_stable_baselines3_keeps_its_actions(normalize: bool, tmp_path: Path) -> None:
    adapter = library("stable_baselines3", "sb3")
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

    plain = VecMonitor(adapter.Sb3Env(make()))
    env = VecNormalize(plain, clip_obs=1.5) if normalize else plain
    learner = PPO("MlpPolicy", env, n_steps=4, batch_size=64, n_epochs=1, device="cpu", seed=0)
    learner.learn(256)
    save_policy(learner, tmp_path, task="position_setpoint_task")
    policy, _ = load_policy(tmp_path)
    seen = 3.0 * torch.randn(50, 13, generator=torch.Generator().manual_seed(1))
    given = env.normalize_obs(seen.numpy()) if normalize else seen.numpy()
    expected = torch.as_tensor(learner.predict(given, deterministic=True)[0])
    torch.testing.assert_close(policy({"observations": seen}), expected, atol=1e-5, rtol=0.0)
    squashed = SAC("MlpPolicy", plain, device="cpu", buffer_size=100)
    assert_refused(
        ConfigError, "policy of stable-baselines3: SAC", save_policy, squashed, tmp_path, task="tracking_task"
    )


def test_a_normaliser_of_rsl_rl_and_of_skrl_is_kept(tmp_path: Path) -> None:
    """That of rsl_rl has no limit, that of skrl clamps at 5."""
    rsl_rl, skrl = library("rsl_rl", "rsl-rl"), library("skrl", "skrl")
    from rsl_rl.models import MLPModel
    from skrl.resources.preprocessors.torch import RunningStandardScaler
    from skrl.utils.model_instantiators.torch import gaussian_model

    env, seen = rsl_rl.RslRlEnv(make()), 9.0 * torch.randn(50, 13, generator=torch.Generator().manual_seed(1))
    noise = {"class_name": "GaussianDistribution"}
    actor = MLPModel(env.get_observations(), {"actor": ["observations"]}, "actor", 4, [8], "elu", True, noise)
    actor.obs_normalizer.update(seen / 4.0)
    runner = type("Runner", (), {"__module__": "rsl_rl.runners", "alg": SimpleNamespace(actor=actor)})()
    save_policy(runner, tmp_path / "rsl_rl", task="position_setpoint_task")
    wrapped = skrl.SkrlEnv(make())
    layers = [{"name": "net", "input": "OBSERVATIONS", "layers": [8], "activations": "relu"}]
    network = gaussian_model(
        observation_space=wrapped.observation_space, action_space=wrapped.action_space, network=layers, output="ACTIONS",
        device="cpu",
    )  # fmt: skip
    scaler = RunningStandardScaler(13, device="cpu")
    scaler(seen / 4.0, train=True)
    agent = type("Agent", (), {"__module__": "skrl.agents", "models": {"policy": network}})()
    agent._observation_preprocessor = scaler
    network.act({"observations": seen}, role="policy")  # makes its layers
    save_policy(agent, tmp_path / "skrl", task="position_setpoint_task")
    mean = network.act({"observations": scaler(seen)}, role="policy")[-1]["mean_actions"]
    for name, expected in (("rsl_rl", actor({"observations": seen})), ("skrl", mean)):
        flown = load_policy(tmp_path / name)[0]({"observations": seen})
        torch.testing.assert_close(flown, expected.detach().clamp(-1.0, 1.0), atol=1e-4, rtol=0.0)


def test_wrappers_of_other_libraries_take_the_environments() -> None:
    library("stable_baselines3", "sb3")
    import gymnasium
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.env_util import make_vec_env

    known = "aerial_gym/PositionSetpoint-v0"
    check_env(gymnasium.make(known))
    env = make_vec_env(known, n_envs=2, seed=3)
    observation = env.reset()
    assert observation.shape == (2, 13)
    assert (observation[0] != observation[1]).any()
    library("skrl", "skrl")
    from skrl.envs.wrappers.torch import wrap_env

    from aerial_gym.rl_training import GymnasiumVectorEnv

    for made, count in ((gymnasium.make(known), 1), (GymnasiumVectorEnv(make(), autoreset_mode="same_step"), ENVS)):
        wrapped = wrap_env(made)
        wrapped.reset()
        observation, *columns, _ = wrapped.step(torch.zeros(count, 4))
        assert (wrapped.num_envs, observation.shape) == (count, (count, 13))
        assert [column.shape for column in columns] == [(count, 1)] * 3
