"""Configurations and task files: loading, writing back, and every refusal by name.
Whatever stands in a YAML file becomes a configuration or one sentence; files that build on others; and consoles.
"""

import io
import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from aerial_gym import ENVIRONMENTS, ROBOTS, SIMS, task_registry
from aerial_gym.config import build, dump_yaml, load, to_mapping
from aerial_gym.config.console import accept_any_console, json_line
from aerial_gym.config.loader import convert
from aerial_gym.config.robot import BodyCfg, InitialStateCfg, MountCfg, RobotCfg, RotorCfg, load_robot
from aerial_gym.config.sensor import load_sensor
from aerial_gym.config.sim import SimCfg
from aerial_gym.config.storage import write_atomic
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ActionCfg, CommandCfg, EndRewardCfg, ImageCfg, ObservationCfg, RewardCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics import rotor_state_for_thrust
from aerial_gym.rl_training import load_settings
from aerial_gym.rl_training.settings import TRAINING_CONFIGS
from aerial_gym.sensors import IMUS, SENSORS
from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
from tests.builders import simulation
from tests.refusals import assert_refused

BODY = {"mass": 1.0, "inertia": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1.5e-3]], "source": "test"}
ROTOR = {"thrust_map": [0.0, 0.0, 1e-6], "torque_ratio": 0.01, "thrust_range": [0.0, 2.0], "source": "test"}
ROTOR |= {"time_constant_up": 0.04, "time_constant_down": 0.04}


SHIPPED = {"robot": ROBOTS, "environment": ENVIRONMENTS, "IMU": IMUS, "sensor": SENSORS, "simulation": SIMS}


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind, family in SHIPPED.items() for name in family.names()]
)
def test_every_configuration_survives_writing_and_reading(kind: str, name: str, tmp_path: Path) -> None:
    path, cfg = tmp_path / "cfg.yaml", SHIPPED[kind].get(name)
    path.write_text(dump_yaml(cfg), encoding="utf-8")
    assert (load_sensor(path) if kind == "sensor" else load(type(cfg), path)) == cfg


@pytest.mark.parametrize("name", ROBOTS.names())
def test_every_robot_can_hover_inside_its_thrust_limits_and_names_its_sources(name: str) -> None:
    robot = ROBOTS.get(name)
    for rotor in robot.rotor_types:
        low, high = rotor.thrust_range
        assert low < robot.body.mass * 9.81 / robot.num_rotors < 0.9 * high
    for part in (robot.body, *robot.rotor_types, robot.mounts, robot.collision):
        assert len(part.source) > 10


def test_tinyprop_is_table_4_of_the_appendix() -> None:
    robot = ROBOTS.get("tinyprop")
    assert robot.body.mass == 0.373
    np.testing.assert_allclose(np.diag(robot.body.inertia), [1.5914e-3, 1.5312e-3, 2.5329e-3], rtol=1e-6)
    np.testing.assert_allclose(robot.rotor.thrust_map[2] * (2 * np.pi) ** 2, 1.286412e-5, rtol=1e-6)
    hover = rotor_state_for_thrust(robot.rotor, 0.373 * 9.81 / 4)
    np.testing.assert_allclose(hover / (2 * np.pi), 266.7, atol=0.1)


def test_numbers_written_with_an_exponent_and_no_point_are_numbers(tmp_path: Path) -> None:
    path = tmp_path / "sim.yaml"
    path.write_text("summary: s\ndt: 1e-2\nsource: s\n")
    assert load(SimCfg, path).dt == 0.01


def test_torque_map_follows_the_ratio() -> None:
    cfg = rotor(thrust_map=[0.1, -1e-4, 1e-6])
    np.testing.assert_allclose(cfg.torque_coefficients, [1e-3, -1e-6, 1e-8])
    np.testing.assert_allclose(rotor_state_for_thrust(cfg, 0.1 - 1e-4 * 900 + 1e-6 * 900**2), 900.0)


@pytest.mark.parametrize("name", task_registry.names())
def test_a_task_is_written_and_read_again(name: str, tmp_path: Path) -> None:
    points = CommandCfg(generator="sequence", params={"points": ((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)), "radius": 0.2})
    late = ActionCfg(delay_steps=(1, 3), filter_time_s=0.1)
    cfg = replace(task_registry.get(name), command=points, action=late, images={"depth": ImageCfg()})
    (tmp_path / "task.yaml").write_text(dump_yaml(cfg))
    assert load(TaskCfg, tmp_path / "task.yaml") == cfg


@pytest.mark.parametrize(("field", "way_out"), [
    ("reward", "give rewards: "),
    ("reward_params", "each of the rewards has params of its own; that of a crash is crash_reward"),
    ("max_distance", "term: far_from_target, kind: crash"),
    ("success_radius", "term: at_target, kind: success, when: at_end"),
    ("target", "generator: point"),
    ("target_ratio_low", "generator: drawn_point"),
    ("target_ratio_high", "generator: drawn_point"),
    ("action_params", "action: {transform: NAME"),
])  # fmt: skip
def test_a_field_of_an_earlier_version_names_the_way_out(field: str, way_out: str) -> None:
    fields = to_mapping(task_registry.get("position_setpoint_task"))
    with pytest.raises(ConfigError, match=f"my.yaml: field {field!r} is gone: .*{way_out}"):
        build(TaskCfg, fields | {field: 1.0}, where="my.yaml")


@pytest.mark.parametrize(
    ("config", "field", "words"),
    [
        (task_registry.get("position_setpoint_task"), "robots", "a task has vehicles of one kind"),
        (task_registry.get("position_setpoint_task"), "vehicles", "a task has vehicles of one kind"),
        (ENVIRONMENTS.get("empty_env"), "vehicles", "it is called robots"),
    ],
)
def test_several_vehicles_in_a_file_are_refused_with_the_alternative(config: object, field: str, words: str) -> None:
    with pytest.raises(ConfigError, match=f"my.yaml: field {field!r}: {words}"):
        build(type(config), to_mapping(config) | {field: ["x500", "lmf2"]}, where="my.yaml")


def test_forms_of_an_earlier_version_say_what_they_must_be() -> None:
    fields = to_mapping(task_registry.get("position_setpoint_task"))
    words = "my.yaml: action: must be a mapping of the fields of ActionCfg, found 'direct'"
    with pytest.raises(ConfigError, match=words):
        build(TaskCfg, fields | {"action": "direct"}, where="my.yaml")
    with pytest.raises(ConfigError, match="my.yaml: observations = .*: must be a mapping"):
        build(TaskCfg, fields | {"observations": [{"term": "attitude"}]}, where="my.yaml")


def body(**changes: object) -> BodyCfg:
    return build(BodyCfg, BODY | changes, where="here")


def rotor(**changes: object) -> RotorCfg:
    return build(RotorCfg, ROTOR | changes, where="here")


MOUNT = partial(MountCfg, position=(0.0, 0.0, 0.0), spin=1)
OBSERVATION = partial(ObservationCfg, term="attitude")


@pytest.mark.parametrize(("make", "given", "message"), [
    (body, {"mass": 0.0}, "BodyCfg.mass = 0.0: must be > 0 and finite"),
    (body, {"mass": float("nan")}, "BodyCfg.mass = nan: must be > 0 and finite"),
    (body, {"mass": "heavy"}, "here: mass = 'heavy': must be a number"),
    (body, {"inertia": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 5e-3]]}, "violate the triangle inequality"),
    (body, {"inertia": [[1e-3, 0, 0], [0, -1e-3, 0], [0, 0, 1e-3]]}, "principal moments must be > 0"),
    (body, {"inertia": [[1e-3, 1e-4, 0], [0, 1e-3, 0], [0, 0, 1e-3]]}, "must be symmetric"),
    (body, {"inertia": [[1e-3, 0, 0], [0, 1e-3, 0]]}, "must have 3 entries"),
    (body, {"inertia": [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, float("inf")]]}, "must be finite"),
    (body, {"masss": 1.0}, "here: unknown field 'masss'. Did you mean 'mass'\\? Known: mass, inertia, com, accel.*, source"),
    (rotor, {"time_constant_up": -0.1}, "RotorCfg.time_constant_up = -0.1"),
    (rotor, {"thrust_range": [2.0, 1.0]}, "needs low < high, and high > 0"),
    (rotor, {"thrust_range": [-2.0, -1.0]}, "needs low < high, and high > 0"),
    (rotor, {"dead_band": -1.0}, "RotorCfg.dead_band = -1.0"),
    (rotor, {"slew_rate": 0.0}, "RotorCfg.slew_rate = 0.0"),
    (rotor, {"mode": "torque"}, "must be one of speed, force"),
    (rotor, {"mode": "force"}, "in force mode the state is the thrust: omit it"),
    (rotor, {"reverse_thrust_map": [0.0, 0.0, 1e-6]}, "only for a reversible rotor"),
    (rotor, {"thrust_range": [-1.0, 1.0], "thrust_map": [0.1, 0.0, 1e-6]}, "is 0 without speed"),
    (rotor, {"thrust_map": [0.0, 1.0, 0.0]}, "the coefficient of w² must be > 0"),
    (rotor, {"torque_map": [0.0, 0.0, 1e-8]}, "exactly one of torque_ratio and torque_map"),
    (rotor, {"torque_ratio": None}, "exactly one of torque_ratio and torque_map"),
    (rotor, {"torque_ratio": -1.0}, "RotorCfg.torque_ratio = -1.0"),
    (MOUNT, {"spin": 2}, "MountCfg.spin = 2: must be 1 or -1"),
    (MOUNT, {"axis": (0, 0, 0)}, "axis"),
    (InitialStateCfg, {"lin_vel_low": (1.0, 0.0, 0.0), "lin_vel_high": (0.0, 0.0, 0.0)}, "lin_vel_low"),
    (partial(replace, ROBOTS.get("tinyprop")), {"effects": {"rotor_drag": {"dx": float("nan")}}}, "rotor_drag.dx = nan"),
    (OBSERVATION, {"noise_std": -0.1}, "noise_std = -0.1: must be >= 0"),
    (OBSERVATION, {"dropout": 1.0}, "dropout = 1.0: must be a probability, 0 <= dropout < 1"),
    (OBSERVATION, {"dropout_value": float("inf")}, "dropout_value = inf: must be finite"),
    (OBSERVATION, {"hold_steps": 3}, "hold_steps = 3: must be >= 0, and needs a dropout"),
    (OBSERVATION, {"delay_steps": -1}, "delay_steps = -1: must be >= 0"),
    (OBSERVATION, {"delay_steps": (3, 1)}, r"delay_steps = \(3, 1\): must be >= 0, or the fewest and the most"),
    (OBSERVATION, {"history": 0}, "history = 0: must be >= 1"),
    (OBSERVATION, {"scale": 0.0}, "scale = 0.0: must be finite and not 0"),
    (OBSERVATION, {"scale": float("nan")}, "scale = nan"),
    (ActionCfg, {"noise_std": -0.1}, "ActionCfg.noise_std = -0.1: must be >= 0"),
    (ActionCfg, {"filter_time_s": -1.0}, "ActionCfg.filter_time_s = -1.0"),
    (ActionCfg, {"delay_steps": -1}, "ActionCfg.delay_steps = -1"),
    (ImageCfg, {"dtype": "int8"}, "ImageCfg.dtype = 'int8': must be one of uint8, float16, float32"),
    (ImageCfg, {"largest": 0.0}, "ImageCfg.largest = 0.0"),
])  # fmt: skip
def test_impossible_parts_of_robots_and_tasks_are_refused_by_name(make: Callable, given: dict, message: str) -> None:
    assert_refused(ConfigError, message, make, **given)


@pytest.mark.parametrize("number", [3.5e38, -1e308, float("inf"), float("nan")])
@pytest.mark.parametrize("name", ["value", "difficulty_value"])
def test_what_ends_and_terms_are_worth_is_finite_in_single_precision(name: str, number: float) -> None:
    with pytest.raises(ConfigError, match=rf"EndRewardCfg.{name} = .*: must be finite, and at most 3.4e\+38"):
        EndRewardCfg(**({"value": 0.0} | {name: number}))
    with pytest.raises(ConfigError, match=r"RewardCfg.weight = .*: must be finite"):
        RewardCfg(term="distance_bell", weight=number)
    assert EndRewardCfg(value=-3.4028234e38).value < 0.0


@pytest.mark.parametrize("number", [1e308, -3.5e38, 10**400])
def test_a_parameter_of_a_term_is_no_larger_than_single_precision(number: float) -> None:
    fields = to_mapping(task_registry.get("position_setpoint_task"))
    fields["command"] = {"generator": "point", "params": {"position": [0.0, number, 0.0]}}
    with pytest.raises(ConfigError, match=r"my.yaml: command: params.position\[1\] = .*: must be at most 3.4e\+38"):
        build(TaskCfg, fields, where="my.yaml")


@pytest.mark.parametrize(("text", "message"), [
    ("dt: 2024-13-45", "holds a value that YAML cannot read"),
    ("dt: " + "9" * 400, "dt = 999.*must be a finite number"),
    ("dt: " + "9" * 5000, "holds a value that YAML cannot read"),
    ("dt: 0x" + "f" * 5000, "must be a finite number"),
    ("dt: " + "[" * 5000, "nested too deeply|not valid YAML"),
    ("dt: " + "[" * 5000 + "]" * 5000, "nested too deeply|not valid YAML|too long to show"),
    ("dt: &a [*a]", "an alias refers to a node that contains it"),
    ("dt: &a {b: [1, *a]}", "an alias refers to a node that contains it"),
    ("dt: [&a [1], *a, *a]", "must be a number"),
    ("? [1, 2]\n: 3", "not valid YAML|unknown field"),
    ("", "must hold a mapping"),
    ("dt: [1, 2", "not valid YAML"),
    ("- 1\n- 2\n", "must hold a mapping of fields, found list"),
    ("summary: s\n", "field 'dt' is missing"),
])  # fmt: skip
def test_bad_yaml_is_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "sim.yaml"
    assert_refused(ConfigError, "no such file", load, SimCfg, file)
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
    assert_refused(ConfigError, message, simulation, robot, "lee_position_control")


def test_a_companion_is_a_name_beside_the_log() -> None:
    layout = find_mapping("aerial_gym")
    for text, other in (("a", "/etc/b"), ("a", "../b"), ("", "b")):
        assert_refused(ConfigError, "LogMapping.companion", replace, layout, companion={text: other})
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


BROKEN_ROBOT = """
summary: all kinds of faults
body: {mass: -1.0, inertia: [[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.05]], com: [0.0, .nan, 0.0]}
rotor: {thrust_map: [0.0, 0.0, 1e-6], time_constant_up: fast, thrust_range: [3.0, 2.0], torque: 0.1}
mounts: {layout: [{position: [0.1, -0.1], spin: 1}, {spin: 2}]}
effects: {rotor_drag: {dx: .inf}}
visible: maybe
"""

FAULTS_OF_ROBOT = [
    r"body: BodyCfg.mass = -1.0: must be > 0", r"body: BodyCfg.com = .*: must be finite",
    r"body: BodyCfg.inertia = .*triangle inequality", r"rotor: unknown field 'torque'",
    r"rotor: field 'time_constant_down' is missing", r"rotor: time_constant_up = 'fast': must be a number",
    r"rotor: RotorCfg: give exactly one of torque_ratio and torque_map", r"rotor: RotorCfg.thrust_range = .*: needs low < high",
    r"layout\[0\]: position = \[0.1, -0.1\]: must have 3 entries", r"layout\[1\]: field 'position' is missing",
    r"layout\[1\]: MountCfg.spin = 2: must be 1 or -1", r"field 'collision' is missing",
    r"RobotCfg.effects.rotor_drag.dx = inf: must be finite", r"visible = 'maybe': must be true or false",
]  # fmt: skip


def test_one_message_names_all_faults_of_a_robot_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        load_robot(write_file(tmp_path / "mine.yaml", BROKEN_ROBOT))
    head, *lines = str(error.value).splitlines()
    assert head == f"{len(FAULTS_OF_ROBOT)} faults:"
    counts = [sum(bool(re.search(f"mine.yaml: .*{fault}", line)) for line in lines) for fault in FAULTS_OF_ROBOT]
    assert counts == [1] * len(lines)


TASK_FAULTS = {
    "num_envs": 0,
    "rewards": {},
    "terminations": {"far": {"term": "contact", "kind": "crush"}},
    "robots": "x",
}
ENVIRONMENT_FAULTS = {"clearance": -1.0, "bounds_lower_low": [0.0, 0.0], "contact": {"friction": "hard"}, "wind": 1.0}
SENSOR_FAULTS = {"width": 0, "min_range": 9.0, "max_range": 5.0, "noise": {"std": 0.1}, "hfov_deg": 200.0}
TRAINING_FAULTS = {"seed": -1, "checkpoint_every_s": 0.0, "ppo": {"horizon": 0, "gama": 0.9}, "max_time_s": None}


@pytest.mark.parametrize(("base", "faults", "words"), [
    (task_registry.get("position_setpoint_task"), TASK_FAULTS, ("num_envs = 0", "rewards: needs", "'crush'", "'robots'")),
    (ENVIRONMENTS.get("empty_env"), ENVIRONMENT_FAULTS, ("clearance", "must have 3", "'hard'", "unknown field 'wind'")),
    (SENSORS.get("base_depth_camera"), SENSOR_FAULTS, ("width = 0", "min_range = 9.0", "field 'std'", "hfov_deg = 200.0")),
    (load_settings(TRAINING_CONFIGS / "ppo_position_setpoint.yaml"), TRAINING_FAULTS,
     ("seed = -1", "checkpoint_every_s = 0.0", "horizon = 0", "'gama'", "give max_time_s")),
])  # fmt: skip
def test_one_message_names_all_faults_of_other_files(base: object, faults: dict, words: tuple[str, ...]) -> None:
    with pytest.raises(ConfigError) as error:
        build(type(base), to_mapping(base) | faults, where="my.yaml")
    assert [word for word in words if word not in str(error.value)] == []


def test_a_long_list_of_faults_is_cut() -> None:
    with pytest.raises(ConfigError, match=r"(?s)^40 faults:.*points\[19\].*\.\.\. and 20 more$"):
        convert(tuple[float, ...], ["x"] * 40, "points")


def test_a_source_may_be_left_out_but_not_in_files_of_the_package() -> None:
    fields = {key: value for key, value in BODY.items() if key != "source"}
    assert build(BodyCfg, fields, where="here").source == "no source"
    for family in (*SHIPPED.values(), task_registry):
        assert [name for name in family.names() if "no source" in dump_yaml(family.get(name))] == []
