"""A saved state goes on as if nothing had been: bit for bit, in the same simulation and in a new one, through a file."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import pytest
import torch
from torch import Tensor

from aerial_gym import EFFECTS, ROBOTS, ROTOR_MAPS, EnvManager, Task
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.control import CONTROL_LAWS
from aerial_gym.errors import ConfigError
from aerial_gym.physics import BodyState, Vehicle
from aerial_gym.physics.effects.air_motion import RandomForce
from aerial_gym.registry.state import config_digest, describe_own_code
from tests.builders import simulation
from tests.physics.vehicles import robot_with_memory
from tests.unit.task.hover import begin

E = 3
RANDOMIZE = {
    "body.mass": RandomizeCfg(low=0.8, high=1.2),
    "effects.gusts.std": RandomizeCfg(how="value", low=0.5, high=2.0),
    "gains.velocity": RandomizeCfg(low=0.9, high=1.1),
    "sensors.inner.position": RandomizeCfg(how="offset", low=-0.1, high=0.1),
}


def rich(backend: str = "warp", *, env: str = "dynamic_env", seed: int = 1, num_envs: int = E, **changes) -> EnvManager:
    """Return a simulation with moving obstacles, sensors with clocks and latencies, every effect with memory, and draws."""
    sensors = (
        SensorMountCfg(sensor="st_vl53l5cx", name="eye", rate_hz=6.0, latency_s=0.1),
        SensorMountCfg(sensor="bmi088", name="inner", rate_hz=5.0, latency_s=0.1),
    )
    cfg = replace(robot_with_memory(), sensors=sensors)
    options = {"env": env, "num_envs": num_envs, "seed": seed, "backend": backend}
    built = simulation(cfg, "lee_velocity_control", randomize=RANDOMIZE | changes, **options)
    built.reset()
    return built


def fly(env: EnvManager, steps: int) -> list[dict[str, Tensor]]:
    results, actions = [], torch.linspace(-0.5, 0.5, 4 * env.num_envs).view(-1, 4)
    for step in range(steps):
        env.step(actions)
        if step == 3:
            env.reset(torch.arange(env.num_envs) == 1)
        env.render()
        results.append({key: value.clone() for key, value in env.gtd.items()})
    return results


def assert_same(result: list[dict[str, Tensor]], expected: list[dict[str, Tensor]]) -> None:
    for a, b in zip(result, expected, strict=True):
        assert not [key for key in a if not torch.equal(a[key].nan_to_num(7.0), b[key].nan_to_num(7.0))]


@pytest.mark.parametrize(
    ("backend", "env"), [("warp", "dynamic_env"), pytest.param("torch", "empty_env", marks=pytest.mark.slow)]
)
def test_a_loaded_state_flies_on_the_same(backend: str, env: str, tmp_path: Path) -> None:
    flown = rich(backend, env=env)
    fly(flown, 7)
    torch.save(flown.save_state(), tmp_path / "state.pt")
    expected = fly(flown, 7)
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    assert all(isinstance(tensor, Tensor) for tensor in state.values())
    flown.load_state(state)
    assert_same(fly(flown, 7), expected)
    new = rich(backend, env=env, seed=5)
    fly(new, 2)
    new.load_state(state)
    assert_same(fly(new, 7), expected)
    assert new.seed == 1


def test_saving_changes_nothing() -> None:
    plain, saved = rich(), rich()
    fly(plain, 3)
    fly(saved, 3)
    state = saved.save_state()
    assert_same(fly(saved, 4), fly(plain, 4))
    assert any(not torch.equal(tensor, saved.state_tensors()[name]) for name, tensor in state.items())


def navigation_task(seed: int, controller: str | None = None) -> Task:
    return begin("navigation_task", E, seed=seed, controller=controller)


def roll_out(task: Task, steps: int) -> list[dict[str, Tensor]]:
    results = []
    for step in range(steps):
        task.env.gtd["sim_steps"].masked_fill_(torch.arange(E) == step % E, task.cfg.episode_len_steps)
        observation, reward, terminated, _, info = task.step(torch.full((E, 4), 0.3))
        row = {"observation": observation["observations"], "reward": reward, "terminated": terminated} | info
        results.append({key: value.clone() for key, value in row.items()})
    return results


def test_a_task_goes_on_with_its_curriculum_and_returns() -> None:
    task = navigation_task(1)
    roll_out(task, 4)
    state = task.save_state()
    expected = roll_out(task, 5)
    level = int(task.env.gtd["curriculum_level"])
    other = navigation_task(2)
    other.load_state(state)
    assert_same(roll_out(other, 5), expected)
    assert int(other.env.gtd["curriculum_level"]) == level


def test_a_state_of_another_simulation_is_refused() -> None:
    env = rich(env="empty_env")
    state = env.save_state()
    with pytest.raises(ConfigError, match="state: is of another environment"):
        rich(env="landing_env").load_state(state)
    with pytest.raises(ConfigError, match="state: is of another randomize"):
        rich(env="empty_env", **{"body.com": RandomizeCfg(how="offset", low=0.0, high=0.0)}).load_state(state)
    with pytest.raises(ConfigError, match=r"here \(2,.*The number of environments must be the same"):
        rich(env="empty_env", num_envs=2).load_state(state)
    with pytest.raises(ConfigError, match="state: lacks"):
        env.load_state({name: tensor for name, tensor in state.items() if name != "gtd.robot_position"})
    with pytest.raises(ConfigError, match="state: has 'more'"):
        env.load_state(state | {"more": torch.zeros(1)})


class RotorEcho:
    """A law of a user's own package."""

    action_names = ("speed [rad/s]",)
    gains_by_name: ClassVar[dict[str, Tensor]] = {}

    def __init__(self, cfg: object, vehicle: Vehicle, gravity: float, *, gain: float = 1.0, **options: object) -> None:
        self._gain, self._num_rotors = gain, vehicle.num_rotors

    def rotor_command(self, state: BodyState, action: Tensor) -> Tensor:
        return (self._gain * action).expand(-1, self._num_rotors)


class RotorShout(RotorEcho):
    """Another one."""


class GentlePush(RandomForce):
    """An effect of a user's own package."""

    def __init__(self, size: float = 0.0) -> None:
        self.size = size


LAWS = {"echo": RotorEcho, "shout": RotorShout, "half": partial(RotorEcho, gain=0.5)}


@pytest.mark.parametrize("other", ["shout", "half"])
def test_a_state_of_another_law_with_the_same_name_is_refused(other: str, monkeypatch: pytest.MonkeyPatch) -> None:
    cfg = ControllerCfg(summary="echo", law="echo")

    def make(law: str) -> EnvManager:
        monkeypatch.setattr(CONTROL_LAWS, "_entries", {"echo": LAWS[law]})
        built = simulation(ROBOTS.get("tinyprop"), cfg, num_envs=1, seed=0, backend="torch")
        built.reset()
        return built

    state = make("echo").save_state()
    make("echo").load_state(state)
    with pytest.raises(ConfigError, match="of another own_code"):
        make(other).load_state(state)


def test_own_code_is_told_apart_by_class_and_attributes() -> None:
    entries = (GentlePush(), GentlePush(1.0), GentlePush(2.0), *LAWS.values())
    assert len({str(config_digest(describe_own_code({"it": entry}))) for entry in entries}) == len(entries)
    assert describe_own_code({"drag": EFFECTS.get("rotor_drag"), "map": ROTOR_MAPS.get("polynomial")}) == {}
