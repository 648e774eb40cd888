"""Robot files with drag of links, and what takes such a robot as rigid in its reference pose."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.model import check_effects, effects_on_rigid, robot_effects
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.robots.tune import tune_robot
from aerial_gym.sim2real.identify.selection.select import select_effects
from aerial_gym.sim2real.judge.analysis import correct_robot, untestable_effects
from aerial_gym.sim2real.predict.model_params import params_from_robot
from tests.unit.sim2real.judge.builders import make_excess, make_setup
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import make_selection

FILE = """
extends: morphy
effects:
  link_drag: {qx: 0.002, qz: 0.004, azimuth_1.qz: 0.01, base.qz: 0.02}
  quadratic_drag: {dx: 0.01, dy: 0.01, dz: 0.02}
effects_source: test
"""


@pytest.fixture
def drag_robot(tmp_path: Path) -> RobotCfg:
    (tmp_path / "dragged.yaml").write_text(FILE)
    return robot_by_name(str(tmp_path / "dragged.yaml"))


def test_a_robot_file_names_links(drag_robot: RobotCfg) -> None:
    check_effects(drag_robot)
    effects = robot_effects(drag_robot, num_envs=2, device=torch.device("cpu"), dtype=torch.float64)
    (law, params), _ = effects
    assert [parameter.name for parameter in law.parameters] == ["qx", "qz", "azimuth_1.qz", "base.qz"]
    assert params[1].tolist() == [0.002, 0.004, 0.01, 0.02]


def test_what_takes_it_as_rigid_leaves_drag_of_links_out(drag_robot: RobotCfg) -> None:
    assert list(effects_on_rigid(drag_robot)) == list(params_from_robot(drag_robot).effects) == ["quadratic_drag"]
    effects = robot_effects(drag_robot, num_envs=1, device=torch.device("cpu"), dtype=torch.float64, rigid=True)
    assert [effect.name for effect, _ in effects] == ["quadratic_drag"]
    tune_robot(drag_robot, name="dragged", attitude=5.0, position=1.0, damping=0.8, dt=0.002)


def test_the_loop_lists_it_as_not_testable_and_keeps_it(drag_robot: RobotCfg) -> None:
    selection, air = make_selection(), make_excess()
    told = untestable_effects(selection, drag_robot, air)
    acting = dict.fromkeys(("link_drag", "link_buoyancy", "link_added_mass"), "acts_on_links")
    assert {name: finding.code for name, finding in told.items()} == acting
    assert untestable_effects(selection, ROBOTS.get("tinyprop"), air) == {}
    params = params_from_robot(drag_robot).with_effect("rotor_drag", torch.tensor([0.1, 0.2, 0.3]).numpy())
    result = correct_robot(make_setup([hover("f", 1.0)], robot=drag_robot), params, ["rotor_drag"])
    assert set(result.effects) == {"link_drag", "quadratic_drag", "rotor_drag"}
    assert result.effects["link_drag"] == drag_robot.effects["link_drag"]
    check_effects(result)


def test_it_cannot_be_requested() -> None:
    with pytest.raises(ConfigError, match="link_drag acts on links where they are.* cannot be asked for"):
        select_effects(None, None, None, lambda *_: None, candidates=("link_drag",))


def test_a_rigid_robot_file_is_refused() -> None:
    rigid = replace(ROBOTS.get("tinyprop"), effects={"link_drag": {"qx": 0.1}}, effects_source="test")
    with pytest.raises(ConfigError, match="Give it rotor_drag, quadratic_drag or hull_drag, or joints"):
        check_effects(rigid)
