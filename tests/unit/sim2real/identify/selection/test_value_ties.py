"""Declared values that flights show as ratios only: which are named, and which combinations of others are stated as ties."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.identify.candidates.nuisance import prior_of_flight_offsets
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
from aerial_gym.sim2real.identify.selection.select import FinalFit, SelectionResult
from aerial_gym.sim2real.identify.selection.value_ties import ValueTie
from aerial_gym.sim2real.judge.verdict import names_of_ties
from aerial_gym.sim2real.predict.model_params import params_from_robot
from tests.repetitions import rare_values
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor
from tests.unit.sim2real.identify.selection.test_select import ROTORS, select_hidden
from tests.unit.sim2real.set_fits import make_choice, make_fit

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


class RatioFit(FinalFit):
    """Fit of named effects to flights that the model itself flew with them, with white noise."""

    def __init__(self, folder: Path, named: Mapping[str, Sequence[float]], missing: Sequence[str]) -> None:
        robot = replace(ROBOT, effects={"rotor_drag": DRAG, "rotor_inertia": {"jr": 6e-6}}, effects_source="declared")
        tables = [flight(seed, rate=100.0, noise=1.0, seconds=6.0, drag=0.3) for seed in range(3)]
        self.predictor = make_predictor(
            load_tables(folder, [t.drop(columns=list(missing)) for t in tables], robot), robot
        )
        self.declared = self.params = params_from_robot(robot)
        for name, values in named.items():
            self.params = self.params.with_effect(name, np.array(values))
        rng = np.random.default_rng(0)
        noise = [0.05 if channel.kind == "specific_force" else 0.2 for channel in self.predictor.channels]
        predicted = self.predictor.predict(self.params)
        self.predictor.measured = [part + noise * rng.standard_normal(part.shape) for part in predicted]
        weights = inverse_variance_weights(self.predictor.residuals(self.params))
        self.chosen = replace(make_choice(make_fit(*named)), weights=weights)
        tolerance = tolerance_jacobian(self.predictor, self.params, np.float32)
        self.tolerance, self.offsets = tolerance, prior_of_flight_offsets((), self.predictor.channels, weights.weight)
        self.beside = NuisanceSums(self.predictor.times, [[part] for part in tolerance], weights.weight)

    def ties(self, named: Iterable[str]) -> tuple[ValueTie, ...]:
        return self.find_ties(self.fit(tuple(named), self.params)[0], (*VALUES, "rotor_inertia", "com_offset"))


GYRO, FORCES = ("omega_x", "omega_y", "omega_z"), ("acc_x", "acc_y", "acc_z", "v_x", "v_y", "v_z", "p_x", "p_y", "p_z")
LEVERS = {"torque_ratio": 1.0, "arm_length": 1.0}
SCALES = {
    "payload_mass": ((), [{"thrust_coefficient": -1.0, "rotor_drag": -1.0, **dict.fromkeys(LEVERS, 1.0)},
                          {"thrust_coefficient": -1.0, "rotor_drag": -1.0, "inertia_error": -1.0, "rotor_inertia": -1.0}]),
    "thrust_coefficient": (GYRO, [{"payload_mass": -1.0, "rotor_drag": -1.0}]),
    "rotor_drag": (GYRO, [{"payload_mass": -1.0, "thrust_coefficient": -1.0}]),
    "inertia_error": (FORCES, [{"rotor_inertia": -1.0, "thrust_coefficient": -1.0},
                               {"rotor_inertia": -1.0, "torque_ratio": -1.0, "arm_length": -1.0}]),
    "arm_length": (FORCES, [{"thrust_coefficient": 1.0, "torque_ratio": -1.0}]),
    "com_offset": ((), []),
}  # fmt: skip
"""Powers of the factor of a named value with which others take its place, by the ratios in Newton's and Euler's equations:
``thrust : mass : drag`` and ``thrust x arm : thrust x torque ratio : inertia : rotor inertia``."""


@pytest.mark.parametrize("name", SCALES)
def test_ties_are_the_scalings_of_the_equations_of_motion(name: str, tmp_path: Path) -> None:
    """The named value is 1.2 times the declared one; tiny rotor inertias are no matter."""
    missing, expected = SCALES[name]
    neutral = {"payload_mass": [0.2 * ROBOT.body.mass], "rotor_drag": [0.36] * 3, "com_offset": [0.005, 0.0, 0.0]}
    named = {name: neutral.get(name, [1.2] * (3 if name == "inertia_error" else 1))}
    fit = RatioFit(tmp_path, named, missing)
    ties = {frozenset(tie.params): tie for tie in fit.ties(named)}
    for powers in expected:
        tie = ties[frozenset(powers)]
        assert abs(tie.loss) < 1.0
        for other, power in powers.items():
            values = np.array(list(tie.params[other].values()))
            factor = {"payload_mass": 1.0 + values / ROBOT.body.mass, "rotor_drag": values / 0.3}.get(other, values)
            if other != "rotor_inertia":
                assert factor == pytest.approx(1.2**power, rel=0.03), other
    assert expected or not ties


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
    if "arm_length" in named:  # arms of other length are a torque gain in roll and pitch, for which nobody asked
        gain = next(one for one in result.value_ties if set(one.params) == {"torque_gain"}).params["torque_gain"]
        assert [gain[axis] for axis in ("sx", "sy", "sz")] == pytest.approx([1.0 / 1.33, 1.0 / 1.33, 1.0], rel=0.04)
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


def declare_drag(robot: RobotCfg, **drag: float) -> RobotCfg:
    return replace(robot, effects={"rotor_drag": drag}, effects_source="declared")


def log_shares(table: pd.DataFrame) -> pd.DataFrame:
    """Return a flight with commands as shares of the largest speed, without rotor speeds and gyro."""
    speed = table[ROTORS].to_numpy()
    share = (speed + 0.04 * np.gradient(speed, 0.01, axis=0)) / 2500.0  # the inverse of the rotor lag
    return table.drop(columns=[*ROTORS, *GYRO]).assign(**{f"share_{n + 1}": share[:, n] for n in range(4)})


@pytest.mark.parametrize(("robot", "rivals"), [
    (declare_wrongly(mass=0.9), ["payload_mass"]),
    (declare_drag(ROBOT, dx=0.2, dy=0.3, dz=0.4), []),
])  # fmt: skip
def test_a_drag_is_tied_with_a_mass_if_measured_thrust_scales_the_commands(robot, rivals, tmp_path: Path) -> None:
    """The scale takes any error of the thrust, so a mass changes the ratio of drag to mass alone, for all axes alike."""
    names = ("rotor_drag", "payload_mass")
    result = select_hidden(tmp_path, names, robot=robot, change=log_shares, seconds=6.0, drag=0.3)
    assert result.effect_names == ("rotor_drag",)
    assert names_of_ties("rotor_drag", result) == rivals


@pytest.mark.parametrize(("replaced", "rivals", "causes"), [
    (("rotor_drag",), ("thrust_coefficient", "payload_mass"), ("payload_mass",)),
    (("payload_mass",), ("thrust_coefficient",), ("thrust_coefficient",)),
    (("rotor_drag",), ("inertia_error", "thrust_coefficient", "payload_mass"), ("inertia_error", "payload_mass")),
])  # fmt: skip
def test_a_thrust_that_commands_do_not_determine_makes_no_tie_less_simple(replaced, rivals, causes) -> None:
    tie = ValueTie(
        replaced=replaced, params={name: {} for name in rivals}, loss=0.0, undetermined=("thrust_coefficient",)
    )
    assert tie.causes == causes
    assert tie.is_as_simple == (len(causes) == 1)
    assert replace(tie, undetermined=()).causes == rivals


@pytest.mark.slow
def test_a_single_moment_of_inertia_has_no_tie(tmp_path: Path) -> None:
    """Gyroscopic torques of these flights tell it from a torque gain about its axis."""
    result = select_hidden(tmp_path, VALUES, robot=declare_wrongly(roll_inertia=1.3), seconds=6.0, drag=0.3)
    assert result.effect_names == ("inertia_error",)
    assert result.value_ties == ()
    assert result.fit.params.effects["inertia_error"][0] == pytest.approx(1.0 / 1.3, rel=0.04)
