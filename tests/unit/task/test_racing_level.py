"""Levels of lsy_drone_racing as tasks: the numbers of the file, in our units and names."""

from pathlib import Path

import pytest
import torch

from aerial_gym import ROBOTS, task_registry
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training.settings import settings_for
from tests.refusals import assert_refused
from tests.unit.task.hover import begin

LEVEL = """
[sim]
drone_model = "cf21B_500"
freq = 500
[env]
freq = 100
sensor_range = 0.9
[env.track]
randomize = RANDOMIZE
gates = [{pos = [1.0, 2.0, 0.75], rpy = [0.0, 0.1, 1.5]}, {pos = [-1.0, 0.5, 1.25], rpy = [0.0, 0.0, -1.0]}]
obstacles = [{pos = [0.25, 0.5, 1.5]}]
drones = [{pos = [1.5, -0.6, 0.1], rpy = [0.0, 0.0, 0.2], vel = [0, 0, 0], ang_vel = [0, 0, 0]}]
safety_limits = {pos_limit_low = [-2.4, -1.8, 0.0], pos_limit_high = [2.6, 1.6, 2.0]}
[env.randomizations.drone_pos]
fn = "uniform"
kwargs = {minval = [-0.3, -0.3, 0.0], maxval = [0.3, 0.3, 0.025]}
[env.randomizations.drone_rpy]
fn = "uniform"
kwargs = {minval = [-0.05, -0.05, -0.05], maxval = [0.05, 0.05, 0.05]}
[env.randomizations.drone_mass]
fn = "uniform"
kwargs = {minval = -0.002, maxval = 0.004}
[env.randomizations.drone_inertia]
fn = "uniform"
kwargs = {minval = [-1e-6, -1e-6, -1e-6], maxval = [2e-6, 2e-6, 2e-6]}
[env.randomizations.gate_pos]
fn = "uniform"
kwargs = {minval = [-0.1, -0.2, -0.3], maxval = [0.1, 0.2, 0.3]}
[env.randomizations.gate_rpy]
fn = "uniform"
kwargs = {minval = [0.0, -0.01, -0.02], maxval = [0.0, 0.01, 0.02]}
[env.randomizations.obstacle_pos]
fn = "uniform"
kwargs = {minval = [-0.4, -0.5, 0.0], maxval = [0.4, 0.5, 0.0]}
"""


def level(folder: Path, *changes: tuple[str, str], drawn: bool = False) -> str:
    text = LEVEL.replace("RANDOMIZE", str(drawn).lower())
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "level.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_level_has_the_numbers_of_its_file_and_the_settings_of_a_race(tmp_path: Path) -> None:
    task = task_registry.get(level(tmp_path))
    env = task.env
    track, start = env.track, task.start
    assert (task.sim, env.physics_steps_per_env_step) == ("base_sim_2ms", 5)  # 500 Hz, 100 Hz
    gates = [((1.0, 2.0, 0.75), (0.0, 0.1, 1.5)), ((-1.0, 0.5, 1.25), (0.0, 0.0, -1.0))]
    assert [(gate.position, gate.euler) for gate in track.gates] == gates
    assert (track.poles, track.layout) == (((0.25, 0.5, 1.5),), None)
    assert (track.gate_position_low, track.gate_position_high) == ((-0.1, -0.2, -0.3), (0.1, 0.2, 0.3))
    assert (track.gate_euler_low, track.gate_euler_high) == ((0.0, -0.01, -0.02), (0.0, 0.01, 0.02))
    assert (track.pole_low, track.pole_high) == ((-0.4, -0.5, 0.0), (0.4, 0.5, 0.0))
    assert ([asset.count for asset in env.assets], task.command.params["sensor_range"]) == ([2, 1], 0.9)
    mass, inertia = task.randomize["body.mass"], task.randomize["body.inertia"]
    assert (mass.how, mass.low, mass.high, mass.keep_inertia) == ("offset", -0.002, 0.004, True)
    moments = [ROBOTS.get(task.robot).body.inertia[i][i] for i in range(3)]
    assert inertia.low == pytest.approx([1.0 - 1e-6 / moment for moment in moments])
    assert inertia.high == pytest.approx([1.0 + 2e-6 / moment for moment in moments])
    assert start.position_ratio_low == pytest.approx(((1.2 + 3.0) / 6.0, (-0.9 + 3.0) / 6.0, 0.1 / 2.5))
    assert start.position_ratio_high == pytest.approx(((1.8 + 3.0) / 6.0, (-0.3 + 3.0) / 6.0, 0.125 / 2.5))
    assert start.euler_low == pytest.approx((-0.05, -0.05, 0.15))
    assert start.euler_high == pytest.approx((0.05, 0.05, 0.25))
    assert settings_for("ppo", level(tmp_path), device="cpu").name == "ppo_racing_cpu.yaml"


def test_a_level_is_flown(tmp_path: Path) -> None:
    with begin(level(tmp_path), 50) as task:
        task.step(torch.zeros(50, 4))
        start = task.env.gtd["robot_position"]
        assert task.env.dt == pytest.approx(0.01)
        assert (start[:, :2] - torch.tensor([1.5, -0.6])).abs().max() < 0.31
        assert task.env.draws()["body.mass"].min() >= -0.002


def test_a_drawn_track_lies_within_the_safety_limits(tmp_path: Path) -> None:
    task = task_registry.get(level(tmp_path, drawn=True))
    track, start = task.env.track, task.start
    assert (track.layout.lower, track.layout.upper) == (pytest.approx((-1.9, -1.3)), pytest.approx((2.1, 1.1)))
    assert start.position_ratio_low == pytest.approx((0.6 / 6.0, 1.2 / 6.0, 0.1 / 2.5))
    assert start.position_ratio_high == pytest.approx((5.6 / 6.0, 4.6 / 6.0, 0.125 / 2.5))


def test_what_is_not_drawn_is_as_it_is_listed_and_a_missing_level_is_named(tmp_path: Path) -> None:
    path = level(tmp_path)
    text = Path(path).read_text(encoding="utf-8").partition("[env.randomizations")[0]
    Path(path).write_text(text, encoding="utf-8")
    task = task_registry.get(path)
    track = task.env.track
    assert not task.randomize
    assert track.gate_position_low == track.gate_position_high == (0.0, 0.0, 0.0)
    assert_refused(ConfigError, "nowhere.toml: no level can be read", task_registry.get, "nowhere.toml")


DISTURBANCES = """
[env.disturbances.action]
fn = "normal"
scale = 0.001
[env.disturbances.dynamics]
fn = "uniform"
kwargs = {minval = [-0.1, -0.2, -0.3], maxval = [0.1, 0.2, 0.3]}
[env.randomizations.drone_pos]"""


DRAWN = "[env.randomizations.drone_pos]"


def test_disturbances_are_a_random_force_at_500_hz_and_noise_on_commands(tmp_path: Path) -> None:
    task = task_registry.get(level(tmp_path, (DRAWN, DISTURBANCES)))
    assert task.action.noise_std == 0.001
    drawn = {name: (cfg.how, cfg.low, cfg.high) for name, cfg in task.randomize.items() if "force" in name}
    numbers = {"x": 0.1, "y": 0.2, "z": 0.3, "hold": 0.002}
    assert drawn == {f"effects.random_force.{name}": ("value", value, value) for name, value in numbers.items()}
    plain = task_registry.get(level(tmp_path))
    assert plain.action.noise_std == 0.0
    assert not any("force" in name for name in plain.randomize)


@pytest.mark.parametrize(("old", "new", "message"), [
    ("cf21B_500", "cf2x_L250", "sim.drone_model = 'cf2x_L250': only cf21B_500 is known"),
    ("freq = 500", "freq = 400", "sim.freq = 400: no sim has this frequency. Known: 100, 500, 250 Hz"),
    ("freq = 100", "freq = 150", "env.freq = 150: must divide sim.freq = 500"),
    ('fn = "uniform"', 'fn = "normal"', "drone_pos.fn = 'normal': must be 'uniform'"),
    ("randomizations.drone_pos", "randomizations.drone_place", "drone_place: unknown. Known: drone_pos"),
    ("sensor_range = 0.9", "", "field 'sensor_range' is missing"),
    ("[sim]", "[sim", "no level can be read"),
    ("minval = [-0.1, -0.2, -0.3]", "minval = [-0.1, -0.2]", "level.toml: "),
    (DRAWN, f"[env.disturbances.wind]\n{DRAWN}", "wind: unknown"),
    (DRAWN, DISTURBANCES.replace("0.1, 0.2, 0.3", "0.1, 0.2, 0.4"), "dynamics: minval = .* must be opposite"),
    (DRAWN, DISTURBANCES.replace('"normal"', '"uniform"'), "action.fn = 'uniform': must be 'normal'"),
    (DRAWN, DISTURBANCES.replace('"uniform"', '"normal"', 1), "dynamics.fn = 'normal': must be 'uniform'"),
])  # fmt: skip
def test_levels_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert_refused(ConfigError, message, task_registry.get, level(tmp_path, (old, new)))
