"""Whatever stands in a YAML file becomes a configuration or one sentence; files that build on others; and consoles."""

import io
import json
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym import ENVIRONMENTS, ROBOTS
from aerial_gym.config import build, dump_yaml, load
from aerial_gym.config.console import accept_any_console, json_line
from aerial_gym.config.robot import BodyCfg, RobotCfg, load_robot
from aerial_gym.config.sim import SimCfg
from aerial_gym.config.storage import write_atomic
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import load_settings
from aerial_gym.rl_training.settings import TRAINING_CONFIGS
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from tests.builders import simulation


@pytest.mark.parametrize(("text", "message"), [
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
    ("dt: [1, 2", "not valid YAML"),
    ("- 1\n- 2\n", "must hold a mapping of fields, found list"),
    ("summary: s\n", "field 'dt' is missing"),
])  # fmt: skip
def test_bad_yaml_is_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "sim.yaml"
    with pytest.raises(ConfigError, match="no such file"):
        load(SimCfg, file)
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


@pytest.mark.parametrize(("part", "changes", "message"), [
    ("body", {"mass": 1e300}, "robot: mass = inf: is beyond float32"),
    ("body", {"mass": 1e-300}, "robot: mass is zero in float32"),
    ("body", {"com": (1e200, 0.0, 0.0)}, "robot: com = .*is beyond float32"),
    ("body", {"inertia": ((1e-30, 0, 0), (0, 1e-30, 0), (0, 0, 1e-30))}, "no inverse|too far apart|is unstable"),
])  # fmt: skip
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


@pytest.mark.parametrize(("encoding", "text", "shown"), [
    ("ascii", "3 m/s² ± 5 % → 90° ü 日", "3 m/s2 +- 5 % -> 90deg u ?"),
    ("gbk", "m/s² 日", "m/s2 日"),
    ("cp932", "m/s² ± ü", "m/s2 ± u"),
    ("utf-8", "m/s² → 日", "m/s² → 日"),
    ("utf-8", "fl\udcfcg", "fl?g"),
])  # fmt: skip
def test_a_console_shows_plain_letters_for_what_it_lacks(encoding, text, shown, monkeypatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(sys, "stderr", io.StringIO())  # cannot be told
    accept_any_console()
    print(text, end="", flush=True)
    assert stream.buffer.getvalue().decode(encoding) == shown


@pytest.mark.parametrize("encoding", ["ascii", "gbk", "UTF8", None])
def test_json_on_stdout_loses_nothing(encoding: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = type("Stream", (io.StringIO,), {"encoding": encoding})()
    monkeypatch.setattr(sys, "stdout", stream)
    line = json_line({"unit": "m/s²", "path": "日"})
    assert json.loads(line) == {"unit": "m/s²", "path": "日"}
    assert line.isascii() is (encoding in ("ascii", "gbk"))


def test_names_that_are_no_text_are_written_as_their_bytes(tmp_path: Path) -> None:
    write_atomic(tmp_path / "a.txt", b"fl\xfcg".decode("utf-8", "surrogateescape"))
    assert (tmp_path / "a.txt").read_bytes() == b"fl\xfcg"


def write_file(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def test_a_robot_is_its_base_but_for_what_it_says(tmp_path: Path) -> None:
    text = (
        "extends: base_quadrotor_in_gusts\nbody: {mass: 0.3}\neffects: {rotor_drag: {dx: 0.2}, gusts: null}\n"
        "collision: {spheres: [], boxes: [{size: [0.3, 0.3, 0.1]}]}\n"
    )
    robot, base = load_robot(write_file(tmp_path / "mine.yaml", text)), ROBOTS.get("base_quadrotor_in_gusts")
    assert robot.body == replace(base.body, mass=0.3)
    assert robot.effects == {"rotor_drag": {**base.effects["rotor_drag"], "dx": 0.2}}
    assert (robot.collision.spheres, len(robot.collision.boxes)) == ((), 1)
    assert replace(robot, body=base.body, effects=base.effects, collision=base.collision) == base


def test_entries_with_names_are_changed_by_name(tmp_path: Path) -> None:
    text = "extends: morphy\njoints: {layout: {azimuth_2: {spring: {rest: 0.1}}}}\n"
    joints, base = load_robot(write_file(tmp_path / "mine.yaml", text)).joints, ROBOTS.get("morphy").joints
    for joint, before in zip(joints.layout, base.layout, strict=True):
        assert (joint == before) == (joint.name != "azimuth_2")
        assert replace(joint.spring, rest=before.spring.rest) == before.spring


def test_paths_are_relative_to_the_file_that_names_them_and_a_saved_robot_needs_no_other(tmp_path: Path) -> None:
    mesh = "visible: true\nvisual: [{shape: {kind: mesh, path: hull.stl}}]\n"
    middle = f"extends: base_quadrotor\n{mesh}sensors: [own.yaml]\n"
    write_file(tmp_path / "bases" / "middle.yaml", middle)
    last = write_file(tmp_path / "mine" / "last.yaml", "extends: ../bases/middle.yaml\nimu: own_imu.yaml\n")
    robot = load_robot(last)
    assert robot.visual[0].shape.path == str(tmp_path / "bases" / "hull.stl")
    assert robot.sensors == (str(tmp_path / "bases" / "own.yaml"),)
    assert robot.imu == str(tmp_path / "mine" / "own_imu.yaml")
    assert load(RobotCfg, write_file(tmp_path / "elsewhere" / "saved.yaml", dump_yaml(robot))) == robot


@pytest.mark.parametrize(("text", "message"), [
    ("extends: base_quadroto", "'base_quadroto': no such file in the package.* Did you mean 'base_quadrotor'"),
    ("extends: ../up/none.yaml", "none.yaml: no such file"),
    ("extends: [a, b]", "extends = .'a', 'b'.: must be one name"),
    ("extends: mine.yaml", r"extends itself \(mine.yaml -> mine.yaml\)"),
    ("extends: other.yaml", r"extends itself \(mine.yaml -> other.yaml -> mine.yaml\)"),
    ("extends: base_quadrotor\nmas: 1.0", "mine.yaml: unknown field 'mas'"),
    ("extends: morphy\njoints: {layout: {elevation_9: {}}}", "layout: the base has no 'elevation_9'"),
    ("extends: base_quadrotor\nmounts: {layout: {front: {spin: 1}}}", "layout: entries of this list have no names"),
])  # fmt: skip
def test_what_cannot_be_extended_is_refused_in_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    write_file(tmp_path / "other.yaml", "extends: mine.yaml\n")
    with pytest.raises(ConfigError, match=message):
        load_robot(write_file(tmp_path / "mine.yaml", text))


def test_settings_of_training_build_on_others(tmp_path: Path) -> None:
    file = write_file(tmp_path / "mine.yaml", "extends: ppo_position_setpoint\nppo: {horizon: 64}\nseed: 3\n")
    cfg, base = load_settings(file), load_settings(TRAINING_CONFIGS / "ppo_position_setpoint.yaml")
    assert cfg == replace(base, seed=3, ppo=replace(base.ppo, horizon=64))
