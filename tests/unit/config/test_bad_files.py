"""Whatever stands in a YAML file becomes a configuration or one sentence."""

from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym import ENVIRONMENTS, ROBOTS
from aerial_gym.config import build, load
from aerial_gym.config.robot import BodyCfg, RobotCfg
from aerial_gym.config.sim import SimCfg
from aerial_gym.errors import ConfigError
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from tests.builders import simulation

SIM = "summary: s\ndt: {}\nsubsteps: 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("dt: 2024-13-45", "holds a value that YAML cannot read"),
        ("dt: " + "9" * 400, "dt = 999.*must be a finite number"),
        ("dt: " + "9" * 5000, "holds a value that YAML cannot read"),
        ("dt: 0x" + "f" * 5000, "must be a finite number"),
        ("dt: " + "[" * 5000, "nested too deeply|not valid YAML"),
        ("dt: " + "[" * 5000 + "]" * 5000, "nested too deeply|not valid YAML|too long to show"),
        ("dt: &a [*a]", "an alias refers to a node that contains it"),
        ("dt: &a {b: [1, *a]}", "an alias refers to a node that contains it"),
        ("dt: [&a [1], *a, *a]", "must be float"),
        ("? [1, 2]\n: 3", "not valid YAML|unknown field"),
        ("", "must hold a mapping"),
    ],
)
def test_bad_yaml_is_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "sim.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message) as error:
        load(SimCfg, file)
    assert str(file) in str(error.value)
    assert len(str(error.value)) < 600


def test_numbers_that_no_check_can_compute_with_are_refused() -> None:
    matrix = [[1e308, 0.0, 0.0], [0.0, 1e-320, 0.0], [0.0, 0.0, 1e308]]
    with pytest.raises(ConfigError):
        build(BodyCfg, {"mass": 1.0, "inertia": matrix, "source": "s"}, where="here")
    with pytest.raises(ConfigError, match="physics_steps_per_env_step = 10000000000: must be >= 1 and at most"):
        replace(ENVIRONMENTS.get("empty_env"), physics_steps_per_env_step=10**10)


@pytest.mark.parametrize(
    ("part", "changes", "message"),
    [
        ("body", {"mass": 1e300}, "robot: mass = inf: is beyond float32"),
        ("body", {"mass": 1e-300}, "robot: mass is zero in float32"),
        ("body", {"com": (1e200, 0.0, 0.0)}, "robot: com = .*is beyond float32"),
        ("body", {"inertia": ((1e-30, 0, 0), (0, 1e-30, 0), (0, 0, 1e-30))}, "no inverse|too far apart|is unstable"),
    ],
)
def test_extreme_robots_are_refused_by_name(part: str, changes: dict[str, object], message: str) -> None:
    robot = ROBOTS.get("base_quadrotor")
    robot = replace(robot, **{part: replace(getattr(robot, part), **changes)})
    assert isinstance(robot, RobotCfg)
    with pytest.raises(ConfigError, match=message):
        simulation(robot, "lee_position_control")


def test_a_companion_is_a_name_beside_the_log() -> None:
    layout = find_mapping("aerial_gym")
    for text, other in (("a", "/etc/b"), ("a", "../b"), ("", "b")):
        with pytest.raises(ConfigError, match="LogMapping.companion"):
            replace(layout, companion={text: other})
    assert isinstance(replace(layout, companion={"a": "b"}), LogMapping)
