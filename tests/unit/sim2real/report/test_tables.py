"""Reports: how sure each effect is, what became of each channel, parameters that a robot draws, and lines of evidence."""

from dataclasses import replace
from pathlib import Path

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
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.report.evidence import parameter_evidence, write_evidence
from aerial_gym.sim2real.report.ranges import uncertainty_ranges
from aerial_gym.sim2real.report.tables import channels_by_outcome, reason_rows, rejection_rows, text_rows_of_effects
from aerial_gym.sim2real.statistics import Rise
from aerial_gym.sim2real.wording import text
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor
from tests.unit.sim2real.judge.builders import make_named_effect, make_outcome, make_verdict
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection, make_spread


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
        Finding("follows_structure", "weak_motor", {"structure": "time"}),
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


SCALE, LIGHTER = 0.9, 0.8
EFFECT = "thrust_coefficient"


@pytest.mark.parametrize("lighter", [1.0, LIGHTER])
def test_the_line_is_that_of_all_points_and_each_channel_says_what_it_needs(lighter: float, tmp_path: Path) -> None:
    """Rotors give 0.9 of what is declared. Where the moments of inertia are declared 0.8 times too small as well, forces ask
    for 0.9 and turns for 0.72, no value makes both, and the fit lies between them."""
    body = replace(ROBOT.body, inertia=tuple(tuple(lighter * x for x in row) for row in ROBOT.body.inertia))
    robot = replace(ROBOT, body=body)
    tables = [flight(s, thrust_scale=SCALE, noise=0.1, seconds=6.0) for s in (1, 2)]
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
    truths = {f"angular_acceleration.{axis}": SCALE * lighter for axis in "xy"} | {"specific_force.z": SCALE}
    for name, truth in truths.items():
        assert alone[name].alone == pytest.approx(truth, abs=4.0 * alone[name].std)
        assert alone[name].std < 0.02
    assert clue.channels_to_plot[0].channel.name == max(alone, key=lambda name: alone[name].adds @ alone[name].adds)
    if lighter < 1.0:
        assert SCALE * lighter + 0.01 < clue.fitted < SCALE - 0.01
    assert parameter_evidence(train, params, EFFECT, np.ones(1), weight, untold=("scale",)) == []
    write_evidence(tmp_path / "evidence.csv", {EFFECT: [clue]})
    table = pd.read_csv(tmp_path / "evidence.csv").set_index("channel")
    assert 0.98 < table["share_told"].sum() <= 1.0 + 1e-4
    assert "specific_force.x" not in table.index  # thrust adds nothing there
    turned = "angular_acceleration.x"
    assert table.loc[turned, "alone"] == pytest.approx(alone[turned].alone, rel=1e-5)
