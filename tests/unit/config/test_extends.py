"""Configuration files that build on another: what is merged, what is replaced, where paths lead, and every refusal."""

from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym.config import dump_yaml, load
from aerial_gym.config.robot import RobotCfg, load_robot
from aerial_gym.errors import ConfigError
from aerial_gym.rl_training import load_settings
from aerial_gym.rl_training.settings import TRAINING_CONFIGS
from aerial_gym.robots import ROBOTS


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extends: base_quadroto", "'base_quadroto': no such file in the package.* Did you mean 'base_quadrotor'"),
        ("extends: ../up/none.yaml", "none.yaml: no such file"),
        ("extends: [a, b]", "extends = .'a', 'b'.: must be one name"),
        ("extends: mine.yaml", r"extends itself \(mine.yaml -> mine.yaml\)"),
        ("extends: other.yaml", r"extends itself \(mine.yaml -> other.yaml -> mine.yaml\)"),
        ("extends: base_quadrotor\nmas: 1.0", "mine.yaml: unknown field 'mas'"),
        ("extends: morphy\njoints: {layout: {elevation_9: {}}}", "layout: the base has nothing named 'elevation_9'"),
        ("extends: base_quadrotor\nmounts: {layout: {front: {spin: 1}}}", "layout: entries of this list have no names"),
    ],
)
def test_what_cannot_be_extended_is_refused_in_one_sentence(text: str, message: str, tmp_path: Path) -> None:
    write_file(tmp_path / "other.yaml", "extends: mine.yaml\n")
    with pytest.raises(ConfigError, match=message):
        load_robot(write_file(tmp_path / "mine.yaml", text))


def test_settings_of_training_build_on_others(tmp_path: Path) -> None:
    file = write_file(tmp_path / "mine.yaml", "extends: ppo_position_setpoint\nppo: {horizon: 64}\nseed: 3\n")
    cfg, base = load_settings(file), load_settings(TRAINING_CONFIGS / "ppo_position_setpoint.yaml")
    assert cfg == replace(base, seed=3, ppo=replace(base.ppo, horizon=64))
