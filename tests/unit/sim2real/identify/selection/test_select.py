"""Which names hold on exact flights with a known cause, which only stand in for something, and which cannot be told apart."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.least_squares.derivatives import parameter_scales
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Frozen
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE, Criteria
from aerial_gym.sim2real.identify.selection.partial_rivals import rivals_of_parameters
from aerial_gym.sim2real.identify.selection.select import FinalFit, SelectionResult, select_effects
from aerial_gym.sim2real.judge.verdict import names_of_ties
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from tests.unit.sim2real.flat_flights import ROBOT, PredictorStub, flight, load_tables, make_predictor
from tests.unit.sim2real.set_fits import PLACE, make_choice, make_final_fit, make_fit, make_selection

ROTORS = ["rotor_1", "rotor_2", "rotor_3", "rotor_4"]


def select_hidden(
    folder: Path, candidates: tuple[str, ...], *, change: Callable[[pd.DataFrame], pd.DataFrame] = lambda table: table,
    robot: RobotCfg = ROBOT, seconds: float = 12.0, **hidden: Any,
) -> SelectionResult:  # fmt: skip
    """Return the effects selected from four flights with sensor noise, among some candidates."""
    logs = [change(flight(seed, seconds=seconds, rate=100.0, noise=1.0, **hidden)) for seed in range(4)]
    predictor = make_predictor(load_tables(folder, logs, robot), robot)
    return select_effects(predictor, params_from_robot(robot), Criteria(), candidates=candidates)


def fade_thrust(table: pd.DataFrame) -> pd.DataFrame:
    """Return a flight whose thrust falls from 4 to 14 % below the declared one: rotors turn faster for it. About the
    mean of 9 % that is a third of it (rms)."""
    table[ROTORS] = table[ROTORS].div(np.sqrt(0.96 - 0.1 * table["t"] / table["t"].max()), axis=0)
    return table


def add_ground_push(table: pd.DataFrame) -> pd.DataFrame:
    """Return a flight on which something pushes up where it is low, by 0.3 m/s² per metre."""
    push = 0.3 * (table["p_z"] - 5.0)
    table[ROTORS] = table[ROTORS].mul(np.sqrt(1.0 + push / 9.81), axis=0)
    return table


@pytest.mark.parametrize(("scale", "change", "named", "surrogates"), [
    (1.0, fade_thrust, (), {"thrust_coefficient": "time"}),
    pytest.param(0.9, add_ground_push, ("thrust_coefficient",), {}, marks=pytest.mark.slow),
    pytest.param(0.9, lambda table: table, ("thrust_coefficient",), {}, marks=pytest.mark.slow),
])  # fmt: skip
def test_a_name_holds_or_only_substitutes(scale, change, named, surrogates, tmp_path) -> None:
    result = select_hidden(tmp_path, ("thrust_coefficient", "rotor_drag"), change=change, thrust_scale=scale)
    assert result.effect_names == named
    assert result.surrogates == surrogates


@pytest.mark.parametrize(("gyro", "candidates"), [
    (True, {"thrust_coefficient"}),
    pytest.param(False, {"thrust_coefficient", "payload_mass"}, marks=pytest.mark.slow),
])  # fmt: skip
def test_thrust_and_mass_are_told_by_torques_as_far_as_the_inertia_is_known(gyro, candidates, tmp_path) -> None:
    """5 % less thrust: a mass in its place needs an inertia off by 2.6 deviations about all axes; forces alone do not tell."""

    def log_columns(table: pd.DataFrame) -> pd.DataFrame:
        return table if gyro else table.drop(columns=["omega_x", "omega_y", "omega_z"])

    result = select_hidden(tmp_path, ("thrust_coefficient", "payload_mass"), change=log_columns, thrust_scale=0.95)
    (named,) = result.effect_names
    assert {named, *names_of_ties(named, result)} == candidates


@pytest.mark.slow
@pytest.mark.parametrize("width", [0.04, 0.8])
def test_a_wake_is_found_whatever_its_width(width: float, tmp_path: Path) -> None:
    """0.6 N below a vehicle that flies along, up to two widths aside along each axis; the fit starts at 0.3 m."""
    flights, time = [], np.arange(1200) / 100.0
    for seed in range(4):
        away = 2.0 * width * np.sin(2.0 * np.pi * np.outer(time, (0.31, 0.47)) + seed)
        push = -0.6 * np.exp(-0.5 * (away**2).sum(axis=1) / width**2)
        table = flight(seed, rate=100.0, noise=1.0, outside=np.outer(push, (0.0, 0.0, 1.0)))
        (read,) = load_tables(tmp_path, [table])
        other = read.position + np.column_stack((away, np.ones(1200)))
        flights.append(replace(read, name=str(seed), other_position=other))
    names = ("downwash", "thrust_coefficient", "rotor_drag")
    result = select_effects(make_predictor(flights), params_from_robot(ROBOT), Criteria(), candidates=names)
    assert result.effect_names == ("downwash",)
    force, sigma = result.fit.params.effects["downwash"]
    assert force == pytest.approx(0.6, rel=0.1)
    assert sigma == pytest.approx(width, rel=0.1)


@pytest.mark.slow
def test_a_steady_wind_is_not_called_a_shear_that_hardly_grows(tmp_path: Path) -> None:
    """Between 4 and 6 m a shear with a small power is a constant wind; the wider of two cases is no rival."""
    drag = {"dx": 0.3, "dy": 0.3, "dz": 0.3}
    robot = replace(ROBOT, effects={"rotor_drag": drag}, effects_source="flown with it")
    result = select_hidden(
        tmp_path, ("constant_wind", "wind_shear", "rotor_drag"), robot=robot, drag=0.3, wind=(0.4, -0.3, 0.0)
    )
    assert result.effect_names == ("constant_wind",)
    assert names_of_ties("constant_wind", result) == []
    (rival,) = result.effect_rivals("constant_wind")
    assert (rival.effect, rival.wider, rival.is_clearly_less_probable) == ("wind_shear", True, False)
    assert result.inclusion["constant_wind"] > 0.99  # the shear is this wind as well


DRAGGED = replace(ROBOT, effects={"rotor_drag": {"dx": 0.3, "dy": 0.3, "dz": 0.3}}, effects_source="flown with it")


@pytest.mark.parametrize(("wind", "named"), [((0.0, 0.0, -0.7), ()), ((0.7, 0.0, 0.0), ("constant_wind",))])
def test_a_wind_is_shown_by_its_horizontal_part(wind, named, tmp_path: Path) -> None:
    """A vertical one is as well an error of thrust or mass."""
    result = select_hidden(tmp_path, ("constant_wind",), robot=DRAGGED, seconds=6.0, drag=0.3, wind=wind)
    assert result.effect_names == named
    assert [reason.code for reason in result.refused.values()] == ([] if named else ["interval_holds_neutral"])


def test_a_pull_that_varies_over_positions_is_no_steady_wind(tmp_path: Path) -> None:
    """0.3 N at most towards a place; the accelerometer vibrates by 1 m/s², and the logged position wanders by 0.5 m."""
    centre, logs = np.array([0.7, 0.3, 0.3]), []
    for seed in range(4):
        rng = np.random.default_rng(seed + 100)
        away = flight(seed, rate=100.0)[["p_x", "p_y", "p_z"]].to_numpy() - [0.0, 0.0, 5.0] - centre
        pull = -0.3 * away * np.exp(0.5 - 0.5 * (away**2).sum(axis=1, keepdims=True))
        table = flight(seed, noise=1.0, rate=100.0, drag=0.3, outside=pull)
        table[["acc_x", "acc_y", "acc_z"]] += rng.standard_normal((len(table), 3))
        phase = rng.uniform(0.0, 2.0 * np.pi, 3)
        table[["p_x", "p_y", "p_z"]] += np.sqrt(0.5) * np.sin(0.2 * np.pi * table["t"].to_numpy()[:, None] + phase)
        logs.append(table)
    predictor = make_predictor(load_tables(tmp_path, logs, DRAGGED), DRAGGED)
    names = (
        "constant_wind",
        "wind_shear",
        "rotor_drag",
        "payload_mass",
        "thrust_coefficient",
        "imu_bias",
        "com_offset",
    )
    result = select_effects(predictor, params_from_robot(DRAGGED), Criteria(), candidates=names)
    assert "constant_wind" not in result.effect_names
    assert result.surrogates == {"constant_wind": "position"}


def test_rivals_are_the_best_sets_with_another_effect_in_the_place_of_a_named_one() -> None:
    """Odds count over the overdispersion, here 2: 4 behind are 2, not told apart; 8 behind are 4, told apart."""
    best = make_fit("rotor_drag", "com_offset", log=-100.0, overdispersion=2.0)
    rest = [
        make_fit("quadratic_drag", "com_offset", log=-104.0),
        make_fit("quadratic_drag", "com_offset", log=-106.0, structures=(PLACE,)),  # a worse set with the same
        make_fit("rotor_drag", "motor_tilt", log=-108.0),
        make_fit("constant_wind", log=-101.0, odds={"constant_wind": -1.0}),  # does not hold
        make_fit("com_offset", log=-130.0),  # without it, and nothing in its place
    ]
    result = make_selection(make_choice(best, *rest))
    (drag,), (offset,) = result.effect_rivals("rotor_drag"), result.effect_rivals("com_offset")
    assert (drag.effect, drag.log_odds, drag.is_clearly_less_probable) == ("quadratic_drag", -2.0, False)
    assert drag.fitted is rest[0]
    assert (offset.effect, offset.log_odds, offset.is_clearly_less_probable) == ("motor_tilt", -4.0, True)
    assert [rival.effect for rival in result.effect_ties("rotor_drag")] == ["quadratic_drag"]
    assert result.effect_ties("com_offset") == []


def test_a_wider_case_is_a_rival_and_no_tie() -> None:
    best, wide = make_fit("constant_wind", log=-10.0), make_fit("wind_shear", log=-9.5)
    result = make_selection(make_choice(best, wide))
    (rival,) = result.effect_rivals("constant_wind")
    assert (rival.effect, rival.wider, rival.is_clearly_less_probable) == ("wind_shear", True, False)
    assert result.effect_ties("constant_wind") == []
    (narrow,) = make_selection(make_choice(wide, best)).effect_ties("wind_shear")
    assert (narrow.effect, narrow.wider) == ("constant_wind", False)


def test_what_stands_beside_a_wider_case_replaces_what_else_is_lacking() -> None:
    best = make_fit("motor_time_constant", "imu_bias", log=-10.0)
    result = make_selection(make_choice(best, make_fit("motor_asymmetry", "motor_tilt", log=-10.5)))
    assert [rival.effect for rival in result.effect_rivals("motor_time_constant")] == ["motor_asymmetry"]
    assert result.effect_ties("motor_time_constant") == []
    assert [rival.effect for rival in result.effect_ties("imu_bias")] == ["motor_tilt"]


def test_only_effects_that_can_be_looked_for_are(tmp_path: Path) -> None:
    predictor = make_predictor(load_tables(tmp_path, [flight(1, seconds=4.0, rate=100.0)]))
    for name, error, message in (
        ("rotor_dragg", UnknownNameError, "Did you mean 'rotor_drag'"),
        ("gusts", ConfigError, "gusts is random and predicts no row"),
        ("buoyancy", ConfigError, "buoyancy acts under water"),
    ):
        with pytest.raises(error, match=message):
            select_effects(predictor, params_from_robot(ROBOT), Criteria(), candidates=("rotor_drag", name))


def test_an_effect_that_flights_cannot_show_is_told_when_it_is_requested(tmp_path: Path) -> None:
    result = select_hidden(tmp_path, ("ceiling_effect",), seconds=4.0, drag=0.25)
    assert result.effect_names == ()
    assert set(result.not_testable) == {"ceiling_effect"}


class PriorFit(FinalFit):
    """Parameters known to a given variance, in units of their scale, with what was asked for."""

    def __init__(self, named: EffectSetFit, variance: Mapping[str, Sequence[float]]) -> None:
        drag, offset = (make_fit(name, params={name: [9.0, 8.0, 7.0]}) for name in ("rotor_drag", "com_offset"))
        self.chosen, self.declared = (
            make_choice(named, without={"com_offset": drag, "rotor_drag": offset}),
            ModelParams(),
        )
        self.predictor, self.variance = PredictorStub(), variance

    def fit(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen = frozenset()):
        variance = [v for name in effects for v in self.variance[name]]
        return make_final_fit(start, effects, variance=variance, frozen=frozen)


def test_parameters_that_flights_do_not_show_stay_neutral() -> None:
    named = make_fit(
        "rotor_drag", "com_offset", params={"rotor_drag": [0.2, 0.3, 0.4], "com_offset": [0.004, 0.005, 0.006]}
    )
    given = PriorFit(named, {"rotor_drag": [0.1, 0.9, 1.1], "com_offset": [0.2, 7.0, 0.2]})
    chosen, fit, _ = given.fit_determined()
    assert fit.frozen == {("rotor_drag", 2), ("com_offset", 1)}
    assert {name: values.tolist() for name, values in fit.params.effects.items()} == {
        "rotor_drag": [0.2, 0.3, 0.0],
        "com_offset": [0.004, 0.0, 0.006],
    }
    assert chosen.without["com_offset"].params.effects["rotor_drag"].tolist() == [9.0, 8.0, 0.0]
    assert chosen.without["rotor_drag"].params.effects["com_offset"].tolist() == [9.0, 0.0, 7.0]
    given = PriorFit(named, dict.fromkeys(named.effects, [0.01] * 3))
    same, shown, _ = given.fit_determined()
    assert (shown.frozen, shown.params) == (frozenset(), named.params)
    assert same is given.chosen


def test_an_effect_of_which_the_last_fit_shows_no_parameter_has_no_name() -> None:
    named = make_fit("com_offset", "rotor_drag")
    given = PriorFit(named, {"com_offset": [1.1, 7.0, 1.2], "rotor_drag": [0.1, 0.9, 0.2]})
    drag = given.chosen.without["com_offset"]
    chosen, fit, _ = given.fit_determined()
    assert fit.params is drag.params
    assert chosen.effect_names == ("rotor_drag",)
    assert chosen.refused == {"com_offset": Finding("parameters_unknown", "com_offset")}
    assert chosen.without["rotor_drag"].effects == ()
    assert chosen.without["rotor_drag"].params.effects["com_offset"].tolist() == [0.0, 0.0, 0.0]


def test_an_effect_with_no_effect_in_all_its_intervals_has_no_name() -> None:
    """Half widths of 1.96 times 0.3 scales; an offset of 0.1 scales is then no offset, one of 1 scale along x is."""
    scale = parameter_scales(("com_offset",))
    for first, named in ((0.1, False), (1.0, True)):
        fitted = make_fit("com_offset", params={"com_offset": (scale * [first, 0.1, 0.0]).tolist()})
        given = PriorFit(fitted, {"com_offset": [0.09] * 3})
        given.chosen = replace(given.chosen, without={"com_offset": make_fit()})
        chosen, _, _ = given.fit_determined()
        assert chosen.effect_names == ("com_offset",) * named
        assert chosen.refused.get("com_offset") == (None if named else Finding("interval_holds_neutral", "com_offset"))


def test_an_effect_that_only_an_undetermined_parameter_shows_has_no_name() -> None:
    """z is 60 scales from neutral, but known to 2 scales only, so it stays neutral; x and y are within their half widths."""
    scale = parameter_scales(("com_offset",))
    fitted = make_fit("com_offset", params={"com_offset": (scale * [-0.1, 0.1, 60.0]).tolist()})
    given = PriorFit(fitted, {"com_offset": [0.09, 0.09, 4.0]})
    given.chosen = replace(given.chosen, without={"com_offset": make_fit()})
    chosen, _, _ = given.fit_determined()
    assert chosen.effect_names == ()
    assert chosen.refused == {"com_offset": Finding("interval_holds_neutral", "com_offset")}


TRUE = np.array([1.3, 1.4, 1.6])  # Moments of inertia per declared ones

NAMES = ("inertia_error", "torque_ratio", "thrust_coefficient", "payload_mass", "rotor_drag", "quadratic_drag")


def make_fitter(folder: Path, noise: float) -> Fitter:
    """Return a fitter for flights of a vehicle with misdeclared moments of inertia, which yaws by rotor drag alone."""
    inertia = np.array(ROBOT.body.inertia) / np.sqrt(np.outer(TRUE, TRUE))
    robot = replace(ROBOT, body=replace(ROBOT.body, inertia=tuple(map(tuple, inertia.tolist()))))
    tables = [flight(seed, noise=noise, seconds=8.0, rate=100.0) for seed in range(2)]
    predictor, declared = make_predictor(load_tables(folder, tables, robot), robot), params_from_robot(robot)
    true = declared.with_effect("inertia_error", TRUE)
    return Fitter(predictor, declared, len(NAMES), inverse_variance_weights(predictor.residuals(true)), true)


@pytest.fixture(scope="module")
def fitter(tmp_path_factory: pytest.TempPathFactory) -> Fitter:
    return make_fitter(tmp_path_factory.mktemp("flights"), 8.0)


def fit_start(fitter: Fitter, **params: list[float]) -> EffectSetFit:
    start = fitter.declared
    for name, values in params.items():
        start = start.with_effect(name, np.array(values))
    return fitter.fit(tuple(params), (), start)


def test_an_inertia_about_yaw_may_as_well_be_a_torque_ratio(fitter: Fitter) -> None:
    """1.6 times the inertia turns as 1 / 1.6 of the torque does; nothing else turns so."""
    named = fit_start(fitter, inertia_error=TRUE.tolist())
    result = {(one.effect, one.parameter): one for one in rivals_of_parameters(fitter, named, named.effects, NAMES)}
    one = result["inertia_error", "sz"]
    assert one.other == "torque_ratio"
    assert one.params["scale"] == pytest.approx(1.0 / 1.6, rel=0.05)
    assert abs(one.log_odds) < LEAST_SCORE
    assert (one.finding.code, one.finding.subject) == ("parameter_tied", "inertia_error")
    assert (one.finding.values["parameter"], one.finding.values["other"]) == ("sz", "torque_ratio")
    assert one.as_mapping()["effect"] == "torque_ratio"
    assert ("inertia_error", "sx") not in result


def test_quiet_flights_tell_them_apart(tmp_path: Path) -> None:
    quiet = make_fitter(tmp_path, 1.0)
    assert rivals_of_parameters(quiet, fit_start(quiet, inertia_error=TRUE.tolist()), NAMES, NAMES) == ()


def test_what_is_no_candidate_or_in_the_set_is_no_rival(fitter: Fitter) -> None:
    named = fit_start(fitter, inertia_error=TRUE.tolist())
    assert rivals_of_parameters(fitter, named, named.effects, ("inertia_error", "rotor_drag")) == ()
    both = fit_start(fitter, torque_ratio=[1.0 / 1.6], inertia_error=[1.3, 1.4, 1.0])
    assert all(one.other not in both.effects for one in rivals_of_parameters(fitter, both, both.effects, NAMES))
    assert rivals_of_parameters(fitter, fit_start(fitter, torque_ratio=[1.0 / 1.6]), NAMES, NAMES) == ()
    assert rivals_of_parameters(fitter, named, (), NAMES) == ()
