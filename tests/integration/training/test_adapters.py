"""Tasks as skrl, rsl_rl and Stable-Baselines3 see them, beside the same task as it is; the examples that train with them."""

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor

from aerial_gym import Task, task_registry

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
    assert any(path.is_file() for path in (tmp_path / "run").rglob("*"))
