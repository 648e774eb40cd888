"""Declared values that flights show as ratios only: which are named, and which combinations of others are stated as ties."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.verdict import names_of_ties
from tests.repetitions import rare_values
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.identify.selection.test_select import select_hidden

VALUES = ("payload_mass", "thrust_coefficient", "torque_ratio", "arm_length", "inertia_error", "rotor_drag")
DRAG = {"dx": 0.3, "dy": 0.3, "dz": 0.3}


def declare_wrongly(
    *, mass: float = 1.0, thrust: float = 1.0, arms: float = 1.0, roll_inertia: float = 1.0
) -> RobotCfg:
    """Return the flown robot with numbers multiplied by factors."""
    inertia = np.array(ROBOT.body.inertia)
    inertia[0, 0] *= roll_inertia
    body = replace(ROBOT.body, mass=ROBOT.body.mass * mass, inertia=tuple(map(tuple, inertia.tolist())))
    rotor = ROBOT.rotor
    assert rotor is not None
    maps = {name: tuple(thrust * value for value in getattr(rotor, name)) for name in ("thrust_map", "thrust_range")}
    places = [(arms * x, arms * y, z) for x, y, z in (mount.position for mount in ROBOT.mounts.layout)]
    layout = tuple(replace(mount, position=place) for mount, place in zip(ROBOT.mounts.layout, places, strict=True))
    return replace(
        ROBOT, body=body, rotor=replace(rotor, **maps), mounts=replace(ROBOT.mounts, layout=layout),
        effects={"rotor_drag": DRAG}, effects_source="flown with it",
    )  # fmt: skip


def effects_of_ties(result: SelectionResult) -> set[tuple[frozenset[str], frozenset[str]]]:
    return {(frozenset(tie.replaced), frozenset(tie.params)) for tie in result.value_ties}


CASES = [
    ({"mass": 1.5, "thrust": 1.5}, {"payload_mass", "thrust_coefficient"}, {"inertia_error", "rotor_drag"}, True),
    ({"arms": 1.33}, {"arm_length"}, {"torque_ratio", "inertia_error"}, False),
]
SINGLE = ({"mass": 1.1}, {"payload_mass"}, {"thrust_coefficient", "inertia_error", "rotor_drag"}, False)


@pytest.mark.parametrize(("factors", "named", "rivals", "ambiguous"), rare_values([*CASES, SINGLE], [SINGLE]))
def test_values_that_act_as_ratios_are_tied(factors, named, rivals, ambiguous, tmp_path: Path) -> None:
    """A tie with more causes than the named ones have is stated, and does not make them ambiguous."""
    result = select_hidden(tmp_path, VALUES, robot=declare_wrongly(**factors), seconds=6.0, drag=0.3)
    assert set(result.effect_names) == named
    assert (frozenset(named), frozenset(rivals)) in effects_of_ties(result)
    for name in named:
        assert set(names_of_ties(name, result)) == (rivals if ambiguous else set())
    tie = next(one for one in result.value_ties if set(one.params) == rivals)
    assert tie.loss < 1.0
    if "inertia_error" in rivals:  # an inertia in place of a mass, a thrust or an arm has the inverse factor
        factor = 1.1 if named == {"payload_mass"} else max(factors.values())
        assert tie.params["inertia_error"]["sx"] == pytest.approx(factor, rel=0.04)


def test_a_scale_of_rotor_speeds_is_tied_with_a_thrust_where_no_command_tells_them_apart(tmp_path: Path) -> None:
    names = ("rotor_speed_scale", "thrust_coefficient")
    result = select_hidden(tmp_path, names, robot=declare_wrongly(thrust=0.85), seconds=6.0, drag=0.3)
    assert result.effect_names == ("rotor_speed_scale",)
    (tie,) = result.value_ties
    assert tie.loss < 1.0
    assert tie.params["thrust_coefficient"]["scale"] == pytest.approx(1.0 / 0.85, rel=0.01)


@pytest.mark.slow
def test_a_single_moment_of_inertia_has_no_tie(tmp_path: Path) -> None:
    result = select_hidden(tmp_path, VALUES, robot=declare_wrongly(roll_inertia=1.3), seconds=6.0, drag=0.3)
    assert result.effect_names == ("inertia_error",)
    assert result.value_ties == ()
    assert result.fit.params.effects["inertia_error"][0] == pytest.approx(1.0 / 1.3, rel=0.04)
