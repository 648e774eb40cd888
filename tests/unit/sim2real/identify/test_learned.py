"""A learned residual in the loop: a drag that no effect has is learned and holds on another flight; noise is not learned."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.config import dump_yaml
from aerial_gym.config.robot import load_robot
from aerial_gym.errors import ConfigError
from aerial_gym.sim2real import close_loop
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.learned import (
    OUTPUTS,
    CrossValidation,
    ResidualFit,
    _Layers,
    _Trainer,
    add_test_shares,
    leave_out_flights,
    train_residual,
)
from aerial_gym.sim2real.identify.least_squares.moments import inverse_variance_weights
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.judge.residual_model import fit_residual
from aerial_gym.sim2real.logs.flights import Flight, load_train_and_test
from aerial_gym.sim2real.predict.model_params import params_from_robot
from aerial_gym.sim2real.predict.predictor import Predictor
from tests.physics.vehicles import random_network
from tests.unit.sim2real.flat_flights import ROBOT, flight, make_predictor, write
from tests.unit.sim2real.judge.builders import make_setup
from tests.unit.sim2real.one_rollout import roll_out
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection

CUBIC = 0.08
FORCES, TURNS = OUTPUTS[:3], OUTPUTS[3:]


def fly(folder: Path, cubic: float, *, seconds: float = 8.0) -> tuple[list[Path], Path]:
    tables = [flight(20 + n, noise=1.0, seconds=seconds, rate=100.0, cubic=cubic) for n in range(4)]
    *train, test = [write(table, folder / f"f{n}.csv") for n, table in enumerate(tables)]
    return train, test


def make_judge(predictor: Predictor) -> CrossValidation:
    weights = inverse_variance_weights(predictor.residuals(params_from_robot(ROBOT)))
    return leave_out_flights(predictor, weights, Criteria(), np.full(len(predictor.channels), 0.02))


def learn(folder: Path, cubic: float, *, seconds: float = 8.0) -> tuple[ResidualFit, list[Flight]]:
    train, test = fly(folder, cubic, seconds=seconds)
    fit, held = load_train_and_test(ROBOT, train, [test], None, 10.0)
    predictor, params = make_predictor(fit), params_from_robot(ROBOT)
    learned = train_residual(predictor, params, make_judge(predictor))
    return add_test_shares(learned, make_predictor(held), (params, params), None), held


@pytest.fixture(scope="module")
def cubic(tmp_path_factory: pytest.TempPathFactory) -> tuple[ResidualFit, list[Flight]]:
    return learn(tmp_path_factory.mktemp("cubic"), CUBIC)


def test_a_drag_without_a_name_is_learned_and_holds_on_another_flight(cubic: tuple[ResidualFit, list[Flight]]) -> None:
    learned, held = cubic
    assert learned.effect is not None
    assert min(learned.gaps[name] or 0.0 for name in FORCES) > 0.8
    assert {learned.gaps[name] for name in TURNS} == {0.0}
    assert learned.cfg.limit[3:] == (0.0, 0.0, 0.0)
    assert 0 <= learned.rows_outside < 0.1 * learned.rows
    params, with_it = params_from_robot(ROBOT), replace(params_from_robot(ROBOT), learned=learned.effect)
    errors = [roll_out(ROBOT, held, p, horizons=(0.1, 0.5), given_attitude=True).velocity for p in (params, with_it)]
    rms = [np.sqrt(np.mean(np.square(e), axis=0)) for e in errors if e is not None]
    assert (rms[1] < 0.5 * rms[0]).all()


def test_flights_far_from_the_training_data_get_nothing(cubic: tuple[ResidualFit, list[Flight]]) -> None:
    learned, held = cubic
    far = tuple(tuple(100.0 * number for number in row) for row in learned.cfg.whitening)
    narrow = replace(learned, cfg=replace(learned.cfg, whitening=far))
    judged = add_test_shares(narrow, make_predictor(held), (params_from_robot(ROBOT),) * 2, None)
    assert judged.rows_outside == judged.rows > 0
    assert set(judged.gaps.values()) == {0.0}


def judge_residual(train: list[Path], test: Path, **deviations: float) -> ResidualFit:
    """Return the residual learned on training flights beside deviations of the vehicle, in standard deviations."""
    fit, held = load_train_and_test(ROBOT, train, [test], None, 10.0)
    params, predictor = params_from_robot(ROBOT), make_predictor(fit)
    weights = inverse_variance_weights(predictor.residuals(params))
    tolerated = np.full(len(predictor.channels), 0.02)
    chosen = replace(make_choice(make_fit()), weights=weights, tolerated=tolerated)
    setup = replace(make_setup(), params=params, train=predictor, test=make_predictor(held))
    names = predictor.tolerances.names(ROBOT.num_rotors)
    within = replace(params, deviation=np.array([deviations.get(name, 0.0) for name in names]))
    return fit_residual(setup, make_selection(chosen), params, within, None, seed=0)


def test_test_flights_report_and_do_not_choose(tmp_path: Path) -> None:
    """A test flight that is pushed where training flights are braked gets worse: the share says so, the training decides."""
    train, _ = fly(tmp_path, CUBIC)
    learned = judge_residual(
        train, write(flight(23, noise=1.0, seconds=8.0, rate=100.0, cubic=-CUBIC), tmp_path / "pushed.csv")
    )
    assert learned.effect is not None
    assert max(learned.gaps[name] or 0.0 for name in FORCES) < -0.5


def test_what_a_tolerance_explains_is_not_learned(tmp_path: Path) -> None:
    """Rotors of 1.2 % less thrust, three standard deviations: a network learns it, but beside that deviation nothing."""
    tables = [flight(20 + n, noise=1.0, seconds=8.0, rate=100.0, thrust_scale=0.988) for n in range(4)]
    *train, test = [write(table, tmp_path / f"f{n}.csv") for n, table in enumerate(tables)]
    assert judge_residual(train, test).effect is not None
    assert judge_residual(train, test, **{f"thrust_{rotor}": -3.0 for rotor in range(1, 5)}).effect is None


def test_training_repeats_itself(tmp_path: Path) -> None:
    """Same rows and seed, same numbers; torque is J times acceleration."""
    train, test = fly(tmp_path, CUBIC)
    fit, _ = load_train_and_test(ROBOT, train, [test], None, 10.0)
    predictor = make_predictor(fit)
    trainer = _Trainer(predictor, params_from_robot(ROBOT), make_judge(predictor), 0)
    first = trainer.train(0.01)
    np.testing.assert_array_equal(first.as_vector(), trainer.train(0.01).as_vector())
    constant = replace(first, output=0.0 * first.output, offset=np.eye(6)[4])
    turning = trainer.network_config(constant).output.bias  # J times the rms of angular acceleration y
    rms = np.sqrt(np.mean(np.concatenate(predictor.residuals(params_from_robot(ROBOT)))[:, 4] ** 2))
    np.testing.assert_allclose(turning, (0.0, 0.0, 0.0, 0.0, 2.4e-3 * rms, 0.0), rtol=1e-5)


def test_gradient_of_the_loss_is_that_of_finite_differences() -> None:
    """Central differences of 1e-5 of a smooth function are exact to 1e-9 of its size."""
    rng = np.random.default_rng(0)
    layers = _Layers(rng.normal(size=(4, 3)), rng.normal(size=4), rng.normal(size=(2, 4)), rng.normal(size=2))
    inputs, targets, here = rng.normal(size=(3, 20)), rng.normal(size=(2, 20)), layers.as_vector()

    def loss(numbers: np.ndarray) -> float:
        return layers.from_vector(numbers).loss_and_gradient(inputs, targets, 0.1)[0]

    slopes = [(loss(here + step) - loss(here - step)) / 2e-5 for step in 1e-5 * np.eye(here.size)]
    value, gradient = layers.loss_and_gradient(inputs, targets, 0.1)
    np.testing.assert_allclose(gradient, slopes, atol=1e-8)
    squares = (layers.weights**2).sum() + (layers.output**2).sum()
    np.testing.assert_allclose(value, np.mean((layers(inputs) - targets) ** 2) + 0.1 * squares, rtol=1e-12)


def test_noise_is_not_learned(tmp_path: Path) -> None:
    learned, _ = learn(tmp_path, 0.0, seconds=4.0)
    assert learned.cfg is None
    assert learned.effect is None
    (refusal,) = learned.findings
    assert (refusal.code, [row["code"] for row in refusal.values["objections"]]) == ("learned_refused", ["share_small"])


def test_flights_without_velocity_and_a_robot_that_has_one_are_refused(tmp_path: Path) -> None:
    train, test = fly(tmp_path, CUBIC)
    fit, _ = load_train_and_test(ROBOT, train, [test], None, 10.0)
    predictor = make_predictor(fit)
    judge = make_judge(predictor)
    again = params_from_robot(replace(ROBOT, learned_residual=random_network(4)))
    with pytest.raises(ConfigError, match="already has a learned_residual"):
        train_residual(predictor, again, judge)
    predictor.flights = tuple(replace(f, lin_vel=None) for f in fit)
    assert train_residual(predictor, params_from_robot(ROBOT), judge).objections == (Finding("no_velocity"),)


@pytest.mark.slow
def test_the_loop_adds_it_beside_the_verdict(tmp_path: Path) -> None:
    """Named effects come first; the verdict stays unexplained, and the corrected robot is replayed with the network.

    Linear drag leaves most of a cubic one's gap closed, so that the network's share is of what it leaves.
    """
    train, test = fly(tmp_path, CUBIC)
    (tmp_path / "robot.yaml").write_text(dump_yaml(ROBOT), encoding="utf-8")
    out = tmp_path / "out"
    result = close_loop(tmp_path / "robot.yaml", train, [test], out, effects=("rotor_drag",), learn_residual=True)
    verdict = json.loads((out / "verdict.json").read_text())
    assert verdict["verdict"] == "unexplained"
    *named, last = verdict["effects"]
    assert named
    assert [effect["name"] for effect in named] == [effect.name for effect in result.effects]
    assert (last["name"], last["params"]) == ("learned_residual", {})
    shares, named_shares = last["share_of_gap"], last["share_of_gap_by_named_effects"]
    assert shares["specific_force.y"] > 0.3 * (1.0 - named_shares["specific_force.y"]) > 0.0
    assert last["rows_outside"] <= last["rows"]
    robot = load_robot(out / "robot.yaml")
    assert "f0, f1, f2" in robot.learned_residual.source
    held = load_train_and_test(ROBOT, train, [test], None, 10.0)[1]
    residual = np.concatenate(make_predictor(held, robot).residuals(params_from_robot(robot)))
    after = [verdict["after"]["specific_force"][axis]["rms"] for axis in "xyz"]
    np.testing.assert_allclose(np.sqrt(np.mean(residual[:, :3] ** 2, axis=0)), after, atol=1e-5)  # 1 g of six digits
    assert "learned_added" in [finding["code"] for finding in verdict["findings"]]
    for report in ("report.md", "report.html"):
        assert "learned_residual" in (out / report).read_text()
