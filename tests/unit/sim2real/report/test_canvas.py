"""Figures as SVG: where marks come to lie, which effects are drawn, and what a residual depends on.
Reports: how sure each effect is, what became of each channel, parameters that a robot draws, and lines of evidence.
"""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from aerial_gym.robots import ROBOTS
from aerial_gym.robots.parameter_draws import correlation_factor
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.gauss_newton import fit_effects
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
from aerial_gym.sim2real.judge.verdict import NamedEffect
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.report.canvas import INCH, Panel, panels, ticks
from aerial_gym.sim2real.report.evidence import parameter_evidence, write_evidence
from aerial_gym.sim2real.report.figures import most_probable_single_effects
from aerial_gym.sim2real.report.profiles import mean_residual_profiles, write_profiles
from aerial_gym.sim2real.report.ranges import uncertainty_ranges
from aerial_gym.sim2real.report.tables import channels_by_outcome, reason_rows, rejection_rows, text_rows_of_effects
from aerial_gym.sim2real.statistics import Rise
from aerial_gym.sim2real.wording import text
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor
from tests.unit.sim2real.judge.builders import make_named_effect, make_outcome, make_verdict
from tests.unit.sim2real.set_fits import PLACE, make_choice, make_fit, make_selection, make_spread


def path_points(panel: Panel) -> list[np.ndarray]:
    """Return the points of each mark; a path has one absolute point in each stroke, then relative ones."""
    paths = re.findall(r'<path style[^>]* d="([^"]*)"', panel.html(panel.x_values))
    strokes = [[np.array(re.findall(r"-?\d+", one), dtype=float) for one in path.split("M")[1:]] for path in paths]
    return [
        np.concatenate([np.cumsum(one[: one.size // 2 * 2].reshape(-1, 2), axis=0).ravel() for one in path])
        for path in strokes if path
    ]  # fmt: skip


def test_a_line_lies_where_its_numbers_are() -> None:
    """Five per cent beside the ends: 0 and 10 come to lie at 1/22 and 21/22 of a panel, upright from the bottom."""
    panel = Panel(size=(2200.0, 1100.0))
    panel.line(np.array([0.0, 10.0]), np.array([-1.0, 1.0]), "#123456")
    np.testing.assert_array_equal(path_points(panel)[0], [100.0, 1050.0, 2100.0, 50.0])


def test_a_logarithmic_axis_has_equal_steps_for_equal_factors_and_bars_stand_on_its_frame() -> None:
    """1, 10 and 100 are equally far apart; zero, the foot of a bar, is the frame."""
    panel = Panel(size=(900.0, 1100.0), log=True, names=("a", "b", "c"))
    panel.bars(np.arange(3.0), np.array([1.0, 10.0, 100.0]), 0.8, "#123456")
    corners = path_points(panel)[0].reshape(3, 4, 2)
    np.testing.assert_array_equal(corners[:, 0, 1], 1100.0)
    np.testing.assert_array_equal(corners[:, 1, 1], [1050.0, 550.0, 50.0])


@pytest.mark.parametrize("rows", [100, 100_000])
def test_a_long_line_keeps_what_is_seen_of_it(rows: int) -> None:
    panel = Panel(size=(3000.0, 1000.0))
    time, values = np.arange(rows) / rows, np.random.default_rng(0).normal(size=rows)
    panel.line(time, values, "#123456")
    x, y = path_points(panel)[0].reshape(-1, 2).T
    assert x.size == (rows if rows < 300 else pytest.approx(2 * 3000 / 1.1 / 10, abs=4))
    assert np.all(np.diff(x) >= 0.0)
    assert (y.min(), y.max()) == (pytest.approx(45.0, abs=1.0), pytest.approx(955.0, abs=1.0))


def test_what_is_not_known_is_a_gap() -> None:
    panel, empty = Panel(size=(2200.0, 1100.0)), np.nan
    panel.line(np.arange(6.0), np.array([empty, 0.0, 1.0, empty, 0.0, 1.0]), "#123456")
    panel.error_bars(np.arange(3.0), np.array([0.0, empty, 0.0]), np.ones(3), "#123456")
    panel.line(np.arange(5.0), np.full(5, empty), "#123456")
    panel.dots(np.arange(5.0), np.full(5, empty), "#123456")
    assert [path.size // 2 for path in path_points(panel)[:3]] == [2, 2, 4]
    ElementTree.fromstring(panel.html(panel.x_values))


@pytest.mark.parametrize(("low", "high", "expected"), [
    (-0.1, 1.05, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
    (-7.3, 7.0, [-5.0, -2.5, 0.0, 2.5, 5.0]),
    (97.0, 103.0, range(97, 104)),
])  # fmt: skip
def test_numbers_of_an_axis_are_round(low: float, high: float, expected: list[float]) -> None:
    """Steps of 1, 2, 2.5 or 5 times a power of ten, within the axis."""
    np.testing.assert_allclose(ticks(low, high), list(expected), atol=1e-12)


def test_a_figure_is_well_formed_and_shared_axes_are_alike() -> None:
    figure, grid = panels(3, 2, width=2.0, height=1.0, title="a < b & c", sharex=True)
    grid[0][0].line(np.array([0.0, 1.0, np.nan]), np.array([1.0, 2.0, 3.0]), "#123456", label="<one>")
    grid[1][0].dots(np.array([0.0, 5.0]), np.array([1.0, 1.0]), "#123456")
    figure.legend = grid[0][0].marks
    tree = ElementTree.fromstring(figure.html())
    assert "a < b & c" in {element.text for element in tree.iter("b")}
    assert len(list(tree.iter("svg"))) == 2
    line, dots = (path.get("d", "") for path in tree.iter("path") if path.get("style"))
    assert "nan" not in line
    left, _, step, _ = (float(place) for place in re.findall(r"-?\d+", line))
    start, last = (float(place) for place in re.findall(r"M(\d+)", dots))
    assert start == pytest.approx(left, abs=10.0)
    assert step == pytest.approx((last - start) / 5.0, abs=10.0)
    assert last - start == pytest.approx(2.0 * INCH / 1.1, abs=10.0)


def test_only_single_effects_that_were_fitted_are_drawn() -> None:
    nowhere = make_fit("slung_payload", log=float("-inf"))
    drag = make_fit("rotor_drag", log=-5.0, odds={"rotor_drag": -1.0})
    beside, pair = make_fit("imu_bias", log=-1.0, structures=(PLACE,)), make_fit("imu_bias", "com_offset", log=-2.0)
    assert most_probable_single_effects(make_selection(make_choice(make_fit(), nowhere, drag, beside, pair))) == [drag]
    more = [make_fit("com_offset", log=-4.0), make_fit("motor_tilt", log=-6.0)]
    shown = most_probable_single_effects(make_selection(make_choice(make_fit(), drag, *more)))
    assert [one.effects[0] for one in shown] == ["com_offset", "rotor_drag"]


SCALE = 0.9
TRUE = ModelParams(effects={"thrust_coefficient": np.array([SCALE])})


@pytest.fixture(scope="module")
def flights(tmp_path_factory: pytest.TempPathFactory) -> list[Flight]:
    tables = [flight(seed, thrust_scale=SCALE, noise=0.3, seconds=8.0, rate=100.0) for seed in (1, 2, 3)]
    return load_tables(tmp_path_factory.mktemp("flights"), (one.assign(vbat=15.0 - one["t"] / 8.0) for one in tables))


def test_the_mean_residual_lies_on_the_line_of_what_is_missing(flights: list[Flight]) -> None:
    """At a declared thrust T the force along z is 0.9 T / m: measured minus declared is -0.1 T / m."""
    test = make_predictor(flights)
    profiles = mean_residual_profiles(test, {"declared": ModelParams(), "corrected": TRUE})
    result = {profile.against: profile for profile in profiles}
    assert list(result) == ["thrust [N]", "speed [m/s]", "height [m]", "battery voltage [V]"]
    thrust, z = result["thrust [N]"], [channel.name for channel in test.channels].index("specific_force.z")
    declared, corrected = thrust.residual["declared"], thrust.residual["corrected"]
    line = (SCALE - 1.0) * thrust.middle / ROBOT.body.mass
    assert np.ptp(line) > 5.0 * declared.std_error[:, z].max()  # else any line would do
    assert (np.abs(declared.mean[:, z] - line) < 5.0 * declared.std_error[:, z]).all()
    assert (np.abs(corrected.mean[:, z]) < 5.0 * corrected.std_error[:, z]).all()
    assert declared.count.sum() == sum(time.size for time in test.times)
    for profile in result.values():
        assert ((profile.edges[:-1] <= profile.middle) & (profile.middle <= profile.edges[1:])).all()


def test_only_what_every_log_has_is_drawn(flights: list[Flight]) -> None:
    lost = [replace(flights[0], battery=None), replace(flights[1], position=None), flights[2]]
    told = mean_residual_profiles(make_predictor(lost), {"declared": ModelParams()})
    assert [profile.against for profile in told] == ["thrust [N]", "speed [m/s]"]
    commanded = [replace(one, rotor_command=one.rotor_speed, rotor_speed=None) for one in flights]
    (first, *_) = mean_residual_profiles(make_predictor(commanded), {"declared": ModelParams()})
    (same, *_) = mean_residual_profiles(make_predictor(flights), {"declared": ModelParams()})
    assert first.against == "thrust [N]"
    # Other rows are kept: commands need time to settle.
    assert first.middle[0] == pytest.approx(same.middle[0], rel=0.02)


def test_the_table_has_every_bin_of_every_channel(flights: list[Flight], tmp_path: Path) -> None:
    test = make_predictor(flights)
    result = mean_residual_profiles(test, {"declared": ModelParams(), "corrected": TRUE})
    write_profiles(tmp_path / "profiles.csv", result, test.channels)
    table = pd.read_csv(tmp_path / "profiles.csv")
    assert len(table) == sum(profile.middle.size for profile in result) * len(test.channels)
    own = table[(table["channel"] == "specific_force.z") & (table["against"] == "thrust [N]")]
    place = [channel.name for channel in test.channels].index("specific_force.z")
    np.testing.assert_allclose(own["before"], result[0].residual["declared"].mean[:, place], rtol=1e-5)
    np.testing.assert_allclose(own["after_std_error"], result[0].residual["corrected"].std_error[:, place], rtol=1e-5)


def test_every_channel_is_told_once_with_what_became_of_it() -> None:
    changes = (
        ("specific_force.x", -0.51, -0.6, -0.4),
        ("specific_force.y", 0.0, -0.01, 0.01),
        ("specific_force.z", 0.2, 0.1, 0.3),
        ("rotor_speed.1", -0.87, -0.9, -0.8),
        ("rotor_speed.2", -0.86, -0.9, -0.8),
        ("angular_acceleration.x", 0.1, -0.1, 0.4),
        ("free.velocity", 0.5, 0.4, 0.6, 1.0),  # no channel
    )
    rows = channels_by_outcome(make_verdict(outcomes=tuple(make_outcome(*change) for change in changes)))
    assert list(rows.items()) == [
        ("worse", "specific force z (+20%)"),
        ("better", "specific force x (-51%); rotor speed 1 (-87%), 2 (-86%)"),
        ("same", "specific force y"),
        ("not shown", "angular acceleration x (+10%)"),
    ]


def test_every_effect_says_how_sure_it_is() -> None:
    offset = make_named_effect(
        params={"x": 0.004, "y": -0.002, "z": 0.0}, std={"x": 1e-4, "y": 2e-4}, frozen=("z",), confidence=0.98,
        ties=("motor_tilt",),
    )  # fmt: skip
    gusts = make_named_effect("gusts", params={"std": 0.5}, std={}, confidence=0.999)
    rows = text_rows_of_effects(make_verdict(effects=(offset, gusts)))
    assert rows[0]["parameters"] == "x = 0.004 ± 0.0002 m, y = -0.002 ± 0.00039 m"
    assert rows[0]["sure"] == "confidence 0.98, may as well be motor_tilt"
    assert rows[1] == {"name": "gusts", "parameters": "std = 0.5 m/s", "sure": "confidence 0.999"}


def test_names_that_share_a_reason_share_a_line() -> None:
    reasons = {"a": "no position", "b": "no voltage", "c": "no position"}
    assert reason_rows(reasons) == {"no position": ["a", "c"], "no voltage": ["b"]}


def test_every_effect_that_is_not_named_has_a_reason() -> None:
    rise = Rise(value=0.01, low=0.0, high=0.02)
    adds = {"rotor_drag": 50.0, "com_offset": 1.24, "payload_mass": -3.0, "weak_motor": 9.0}
    chosen = make_choice(
        make_fit("rotor_drag", log=0.0),
        make_fit("rotor_drag", "com_offset", log=float(np.log(0.25))),
        adds=adds | {"motor_tilt": 5.0, "imu_bias": -1.0},
        surrogates={"weak_motor": "time"},
        immaterial={"motor_tilt": {"specific_force.x": rise}},
        refused={"imu_bias": Finding("parameters_unknown", "imu_bias")},
    )
    rows = rejection_rows(make_selection(chosen, not_testable={"downwash": Finding("acts_on_links", "downwash")}))
    assert [(row["effect"], row["log_odds"], row["probability"]) for row in rows] == [
        ("weak_motor", "9.0", "–"),
        ("motor_tilt", "5.0", "–"),
        ("com_offset", "1.2", "0.2"),
        ("imu_bias", "-1.0", "–"),
        ("payload_mass", "-3.0", "–"),
        ("downwash", "–", "–"),
    ]
    expected = [
        Finding("follows_structure", "weak_motor", {"structure": "time", "flights": 2}),
        Finding("trifle", "motor_tilt", {"rise": 0.02}), Finding("only_linear", "com_offset"),
        Finding("parameters_unknown", "imu_bias"), Finding("less_probable", "payload_mass"),
        Finding("acts_on_links", "downwash"),
    ]  # fmt: skip
    assert [row["because"] for row in rows] == [text(finding) for finding in expected]


DX, DY, WIND = "effects.rotor_drag.dx", "effects.rotor_drag.dy", "effects.constant_wind.x"


def make_effect(name: str, params: dict[str, float], std: dict[str, float], **correlation: dict) -> NamedEffect:
    return make_named_effect(name, params=params, std=std, noise_std=std, correlation=correlation)


def test_correlations_stand_beside_deviations_where_both_are_drawn() -> None:
    drag, drag_std = {"dx": 0.2, "dy": 0.1, "dz": 0.3}, {"dx": 0.02, "dy": 0.01}
    effects = (
        make_effect("rotor_drag", drag, drag_std, dy={"rotor_drag.dx": -0.8}),
        make_effect("constant_wind", {"x": 1.0}, {"x": 0.5}, x={"rotor_drag.dx": 0.5, "rotor_drag.dz": 0.1}),
    )
    ranges = uncertainty_ranges(ROBOTS.get("base_quadrotor"), effects)
    assert list(ranges) == [DX, DY, WIND]
    assert [dict(each.correlation) for each in ranges.values()] == [{}, {DX: -0.8}, {DX: 0.5}]
    names, factor = correlation_factor(ranges)
    expected = [[1.0, -0.8, 0.5], [-0.8, 1.0, 0.0], [0.5, 0.0, 1.0]]
    assert names == (DX, DY, WIND)
    np.testing.assert_allclose(factor @ factor.T, expected, atol=2e-6)


def test_the_correlation_of_a_fit_is_that_of_scatter_and_tolerances() -> None:
    """Blocks know the sum best, -3 of 4; the tolerances add 1 to each number alone: -3 of 5."""
    spread = make_spread(np.arange(2), np.eye(2), np.eye(2), blocks=[[4.0, -3.0], [-3.0, 4.0]])
    np.testing.assert_allclose(spread.correlation, [[1.0, -0.6], [-0.6, 1.0]])


TABLE_SCALE, LIGHTER = 0.9, 0.8
EFFECT = "thrust_coefficient"


@pytest.mark.parametrize("lighter", [1.0, LIGHTER])
def test_the_line_is_that_of_all_points_and_each_channel_says_what_it_needs(lighter: float, tmp_path: Path) -> None:
    """Rotors give 0.9 of what is declared. Where the moments of inertia are declared 0.8 times too small as well, forces ask
    for 0.9 and turns for 0.72, no value makes both, and the fit lies between them."""
    body = replace(ROBOT.body, inertia=tuple(tuple(lighter * x for x in row) for row in ROBOT.body.inertia))
    robot = replace(ROBOT, body=body)
    tables = [flight(s, thrust_scale=TABLE_SCALE, noise=0.1, seconds=6.0) for s in (1, 2)]
    flights = load_tables(tmp_path, tables, robot)
    train = make_predictor(flights, robot, channels=find_channels(flights)[:6])
    weight = inverse_variance_weights(train.residuals(ModelParams())).weight  # then all channels count about the same
    empty = [np.zeros((*measured.shape, 0)) for measured in train.measured]
    start = ModelParams(effects={EFFECT: np.ones(1)})
    beside = NuisanceSums(train.times, [[part] for part in empty], weight)
    params = fit_effects(train, (EFFECT,), start, beside)[0].params
    (clue,) = parameter_evidence(train, params, EFFECT, np.ones(1), weight)
    adds, beyond = (np.concatenate([getattr(c, name) for c in clue.clouds]) for name in ("adds", "beyond"))
    slope = (clue.fitted - clue.neutral) / clue.scale
    assert slope == pytest.approx(float(adds @ beyond / (adds @ adds)), abs=2e-3)
    alone = {cloud.channel.name: cloud for cloud in clue.clouds}
    truths = {f"angular_acceleration.{axis}": TABLE_SCALE * lighter for axis in "xy"} | {
        "specific_force.z": TABLE_SCALE
    }
    for name, truth in truths.items():
        assert alone[name].alone == pytest.approx(truth, abs=4.0 * alone[name].std)
        assert alone[name].std < 0.02
    assert clue.channels_to_plot[0].channel.name == max(alone, key=lambda name: alone[name].adds @ alone[name].adds)
    if lighter < 1.0:
        assert TABLE_SCALE * lighter + 0.01 < clue.fitted < TABLE_SCALE - 0.01
    assert parameter_evidence(train, params, EFFECT, np.ones(1), weight, untold=("scale",)) == []
    write_evidence(tmp_path / "evidence.csv", {EFFECT: [clue]})
    table = pd.read_csv(tmp_path / "evidence.csv").set_index("channel")
    assert 0.98 < table["share_told"].sum() <= 1.0 + 1e-4
    assert "specific_force.x" not in table.index  # thrust adds nothing there
    turned = "angular_acceleration.x"
    assert table.loc[turned, "alone"] == pytest.approx(alone[turned].alone, rel=1e-5)
