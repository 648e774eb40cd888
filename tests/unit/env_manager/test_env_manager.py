"""The order of a step, reset by mask, and what stands in the Global Tensor Dictionary; images of some environments.
A saved state goes on as if nothing had been: bit for bit, in the same simulation and in a new one, through a file.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym import CONTROLLERS, EFFECTS, ENVIRONMENTS, ROBOTS, ROTOR_MAPS, SIMS, EnvManager, SimBuilder, Task
from aerial_gym.config import dump_yaml
from aerial_gym.config.controller import ControllerCfg
from aerial_gym.config.environment import AssetCfg, ShapeCfg
from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.sensor_mount import SensorMountCfg
from aerial_gym.control import CONTROL_LAWS
from aerial_gym.errors import ConfigError, ShapeError, UnknownNameError
from aerial_gym.math.quaternion import euler_from_quat, quat_rotate, quat_rotate_inverse
from aerial_gym.physics import BodyState, Vehicle
from aerial_gym.physics.effects.air_motion import RandomForce
from aerial_gym.registry.state import config_digest, describe_own_code
from tests.builders import simulation
from tests.physics.vehicles import robot_with_memory
from tests.refusals import assert_refused
from tests.repetitions import frequent_values
from tests.unit.task.hover import begin


def build(num_envs: int = 4, *, seed: int = 0, **changes: object) -> EnvManager:
    names = {"sim_name": "base_sim", "env_name": "empty_env", "robot_name": "base_quadrotor"}
    names |= {"controller_name": "lee_velocity_control", **changes}
    return SimBuilder().build_env(**names, num_envs=num_envs, device="cpu", seed=seed)


def fly(env: EnvManager, steps: int = 5) -> None:
    env.reset()
    for i in range(steps):
        env.step(torch.tensor([1.0, 0.2 * i, 0.1, 0.3]).expand(env.num_envs, 4))


QUAD = "base_quadrotor"
OFTEN = ("dynamic_env", "empty_env", "forest_env", "landing_env")
"""Of each kind one: obstacles that move, none, obstacles that stand, and a ground."""


@pytest.mark.parametrize(("env_name", "robot_name"), [
    *frequent_values(((name, QUAD) for name in ENVIRONMENTS.names()), [(name, QUAD) for name in OFTEN]),
    pytest.param("empty_env", "morphy", marks=pytest.mark.slow),
])  # fmt: skip
def test_all_states_belong_to_the_same_instant(env_name: str, robot_name: str) -> None:
    env = build(env_name=env_name, robot_name=robot_name)
    fly(env)
    env.reset(torch.tensor([True, False, False, True]))
    gtd = env.gtd
    q = gtd["robot_orientation"]
    torch.testing.assert_close(gtd["robot_body_linvel"], quat_rotate_inverse(q, gtd["robot_linvel"]))
    torch.testing.assert_close(gtd["robot_angvel"], quat_rotate(q, gtd["robot_body_angvel"]))
    torch.testing.assert_close(gtd["robot_euler_angles"], euler_from_quat(q))
    heading = quat_rotate(gtd["robot_vehicle_orientation"], torch.tensor([1.0, 0.0, 0.0]).expand(4, 3))
    yaw = gtd["robot_euler_angles"][:, 2]
    torch.testing.assert_close(heading, torch.stack((yaw.cos(), yaw.sin(), 0 * yaw), dim=-1))
    velocity = quat_rotate_inverse(gtd["robot_vehicle_orientation"], gtd["robot_linvel"])
    torch.testing.assert_close(gtd["robot_vehicle_linvel"], velocity)
    assert torch.equal(gtd["robot_state_tensor"], gtd["vec_root_tensor"][:, 0])
    assert torch.equal(gtd["robot_state_tensor"][:, 10:], gtd["robot_angvel"])


def test_step_keeps_time_and_does_not_reset() -> None:
    env = build(env_name="empty_env_2ms", sim_name="base_sim_2ms")
    assert env.dt == pytest.approx(0.01)
    fly(env, 7)
    assert env.gtd["sim_steps"].tolist() == [7] * 4


@pytest.mark.parametrize("env_name", ["env_with_obstacles", "forest_env", "dynamic_env"])
def test_reset_by_mask_leaves_other_rows_bit_for_bit(env_name: str) -> None:
    env = build(5, env_name=env_name)
    fly(env)
    before = {key: tensor.clone() for key, tensor in env.gtd.items()}
    mask = torch.tensor([False, True, False, False, True])
    env.reset(mask)
    skip = {"num_obstacles_in_env", "robot_clearance"}
    for key, tensor in env.gtd.items():
        if key not in skip:
            assert torch.equal(tensor[~mask], before[key][~mask]), key
    assert (env.gtd["robot_position"][mask] != before["robot_position"][mask]).all()
    assert env.gtd["sim_steps"].tolist() == [5, 0, 5, 5, 0]


def test_flying_into_a_wall_is_a_crash_and_clearance_tells_how_far() -> None:
    env = build(8, env_name="env_with_obstacles")
    env.reset()
    crashed = torch.zeros(8, dtype=torch.bool)
    for _ in range(200):
        env.step(torch.tensor([2.0, 0.0, 0.0, 0.0]).expand(8, 4))
        assert torch.equal(env.gtd["crashes"] | (env.gtd["robot_clearance"] >= 0), torch.ones(8, dtype=torch.bool))
        crashed |= env.gtd["crashes"]
        env.reset(env.gtd["crashes"])
    assert crashed.all()


def test_wrong_requests_are_refused_by_name() -> None:
    assert_refused(UnknownNameError, "no sim 'base_simm'. Did you mean 'base_sim'", build, sim_name="base_simm")
    assert_refused(UnknownNameError, "no robot 'base_quad'", build, robot_name="base_quad")
    assert_refused(ConfigError, "num_envs = 0: must be at least 1", build, 0)
    with pytest.raises(ConfigError, match="device 'gpu': must be auto, cpu, cuda or cuda:N"):
        simulation("base_quadrotor", num_envs=1, device="gpu")
    env = build()
    env.reset()
    with pytest.raises(ShapeError, match=r"actions has shape \(4, 3\), expected \(E, U\) = \(4, 4\): vx \[m/s\]"):
        env.step(torch.zeros(4, 3))


def test_a_device_without_a_number_is_the_first_one_or_refused_by_name() -> None:
    if torch.cuda.is_available():
        assert simulation("base_quadrotor", device=torch.device("cuda")).device == torch.device("cuda:0")
        return
    with pytest.raises(ConfigError, match="this machine shows 0 CUDA devices"):
        simulation("base_quadrotor", device=torch.device("cuda"))


def test_an_imu_on_board_measures_gravity_in_hover_and_nothing_else_moves() -> None:
    """Level in hover it reads g up within bias and noise (1e-3 + 6 x 1.7e-3 x 10); in free fall it reads zero."""
    readings = {}
    for thrust in (0.0, -1.0):
        env = simulation("base_quadrotor_with_imu", "lee_rates_control", num_envs=8, seed=1)
        env.reset()
        env.gtd["robot_linvel"].zero_()
        env.gtd["robot_body_angvel"].zero_()
        actions = torch.zeros(8, 4)
        actions[:, 0] = thrust
        for _ in range(60):
            env.step(actions)
        readings[thrust] = env.gtd["imu_measurement"].clone()
    hover, fall = readings[0.0], readings[-1.0]
    torch.testing.assert_close(hover[:, 2], torch.full((8,), 9.81), rtol=0.0, atol=0.12)
    torch.testing.assert_close(fall[:, :3], torch.zeros(8, 3), rtol=0.0, atol=0.12)
    assert (hover[:, 3:].abs() < 0.2).all()


def test_an_environment_can_be_a_file(tmp_path) -> None:
    file = tmp_path / "mine.yaml"
    place = {"position_ratio_low": (0.5, 0.5, 0.5), "position_ratio_high": (0.5, 0.5, 0.5)}
    box = AssetCfg(name="box", shapes=(ShapeCfg(kind="box", size=(1.0, 1.0, 1.0)),), count=2, **place)
    file.write_text(dump_yaml(replace(ENVIRONMENTS.get("empty_env"), assets=(box,))), encoding="utf-8")
    env = build(env_name=str(file))
    assert env.cfg.assets == (box,)
    env.reset()
    assert env.gtd["obstacle_position"].shape[1:] == (2, 3)
    with pytest.raises(ConfigError, match="none.yaml"):
        build(env_name=str(tmp_path / "none.yaml"))


def test_configurations_stand_in_place_of_names() -> None:
    configurations = {
        "sim_name": SIMS.get("base_sim"), "env_name": ENVIRONMENTS.get("empty_env"),
        "robot_name": ROBOTS.get("base_quadrotor"), "controller_name": CONTROLLERS.get("lee_velocity_control"),
    }  # fmt: skip
    slow = replace(SIMS.get("base_sim"), dt=0.02)
    assert build(**configurations | {"sim_name": slow}).dt == pytest.approx(0.02)
    named, same = build(), build(**configurations)
    for one in (named, same):
        fly(one)
    assert torch.equal(named.gtd["robot_state_tensor"], same.gtd["robot_state_tensor"])


E = 3


def build_cameras() -> EnvManager:
    """Return a simulation with a noisy sensor of a rate and a latency, one of a rate alone, and one of neither."""
    sensors = (
        SensorMountCfg(sensor="st_vl53l5cx", name="late", rate_hz=6.0, latency_s=0.2),
        SensorMountCfg(sensor="st_vl53l5cx", name="slow", rate_hz=4.0),
        SensorMountCfg(sensor="st_vl53l5cx", name="plain"),
    )
    robot = replace(ROBOTS.get("tinyprop"), sensors=sensors)
    return simulation(robot, "lee_velocity_control", env="dynamic_env", num_envs=E, seed=1)


def copy_images(env: EnvManager) -> dict[str, Tensor]:
    return {key: value.clone() for key, value in env.gtd.items() if key.endswith("pixels")}


def test_looking_before_a_reset_and_once_more_where_it_was_gives_the_same_images() -> None:
    once, twice = build_cameras(), build_cameras()
    for env in (once, twice):
        env.reset()
        env.render()
    actions, number = torch.linspace(-0.5, 0.5, 4 * E).view(E, 4), torch.arange(E)
    changed = 0
    for step in range(12):
        mask = (number + step) % 5 == 0
        once.step(actions)
        once.reset(mask)
        once.render()
        twice.step(actions)
        twice.render()
        before = copy_images(twice)
        twice.reset(mask)
        twice.render(mask)
        result = copy_images(twice)
        assert not [key for key, image in copy_images(once).items() if not torch.equal(result[key], image)]
        assert not [key for key in result if not torch.equal(result[key][~mask], before[key][~mask])]
        changed += sum(not torch.equal(result[key][mask], before[key][mask]) for key in result if mask.any())
    assert changed > 10


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


def states_of_flight(env: EnvManager, steps: int) -> list[dict[str, Tensor]]:
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
    states_of_flight(flown, 7)
    torch.save(flown.save_state(), tmp_path / "state.pt")
    expected = states_of_flight(flown, 7)
    state = torch.load(tmp_path / "state.pt", weights_only=True)
    assert all(isinstance(tensor, Tensor) for tensor in state.values())
    flown.load_state(state)
    assert_same(states_of_flight(flown, 7), expected)
    new = rich(backend, env=env, seed=5)
    states_of_flight(new, 2)
    new.load_state(state)
    assert_same(states_of_flight(new, 7), expected)
    assert new.seed == 1


def test_saving_changes_nothing() -> None:
    plain, saved = rich(), rich()
    states_of_flight(plain, 3)
    states_of_flight(saved, 3)
    state = saved.save_state()
    assert_same(states_of_flight(saved, 4), states_of_flight(plain, 4))
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


def test_arrays_and_lists_act_as_tensors_do() -> None:
    tensor = torch.full((2, 4), 0.3)
    states = []
    for actions in (tensor, tensor.double().numpy(), tensor.tolist()):
        env = simulation("base_quadrotor", "lee_attitude_control")
        env.reset()
        env.step(actions)
        states.append(env.gtd["robot_state_tensor"].clone())
        assert torch.equal(states[0], states[-1])
    assert_refused(ShapeError, "actions: must be a tensor or an array of numbers", env.step, "up")
    assert_refused(ShapeError, "actions has shape \\(2, 3\\)", env.step, np.zeros((2, 3)))


def test_text_of_a_simulation_says_size_robot_and_action() -> None:
    env = simulation("base_quadrotor_with_payload", "lee_attitude_control")
    lines = repr(env).splitlines()
    assert lines[0] == "EnvManager: 2 environments on cpu, steps of 0.01 s"
    assert lines[2].endswith("0.25 kg; 4 rotors; effects slung_payload")
    assert lines[3].startswith("  action: thrust")
    env.close()
    assert repr(env) == "EnvManager: 2 environments on cpu, closed"
