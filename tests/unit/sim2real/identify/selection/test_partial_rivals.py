"""One parameter of a named effect may as well be another effect."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.least_squares.weighting import inverse_variance_weights
from aerial_gym.sim2real.identify.selection.partial_rivals import rivals_of_parameters
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE
from aerial_gym.sim2real.predict.model_params import params_from_robot
from tests.unit.sim2real.flat_flights import ROBOT, flight, load_tables, make_predictor

TRUE = np.array([1.3, 1.4, 1.6])
"""Moments of inertia per declared ones."""

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
