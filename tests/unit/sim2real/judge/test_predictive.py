"""Residuals of test flights: how probable training makes them, whether they are noise, and what no tolerance covers."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from aerial_gym.config.robot import RobotCfg
from aerial_gym.interop import one_thread
from aerial_gym.sim2real.identify.candidates.library import linearise_candidates
from aerial_gym.sim2real.identify.candidates.nuisance import OF_FLIGHTS, NuisanceColumns, prior_of_flight_offsets
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import ModelFit, linearise_at_params
from aerial_gym.sim2real.identify.least_squares.moments import block_moments, inverse_variance_weights
from aerial_gym.sim2real.identify.selection.select import default_effects
from aerial_gym.sim2real.judge import predictive
from aerial_gym.sim2real.judge.predictive import ResidualSums, largest_open_squares, quantile_of_squares
from aerial_gym.sim2real.judge.residual_excess import (
    ResidualExcess,
    find_residual_excess,
    is_material_excess,
    model_with_training_deviations,
)
from aerial_gym.sim2real.judge.whiteness import (
    WHITE,
    octave_ranges,
    periodogram_of_flights,
    power_by_octave,
    whiteness_of_channels,
)
from aerial_gym.sim2real.logs.signals import lowpass
from aerial_gym.sim2real.predict.channels import Channel, find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from aerial_gym.sim2real.predict.noise_floor import noise_floor
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.unit.sim2real.flat_flights import ROBOT, flight, make_predictor, uniform_flight
from tests.unit.sim2real.judge.builders import make_evaluation
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection, make_spread

INERTIA = {f"angular_acceleration.{axis}" for axis in "xyz"}


def test_the_quantile_is_exact_for_one_direction_and_for_equal_ones_and_close_to_it_otherwise() -> None:
    """One direction: chi-square of 1; n equal ones: of n. Else against 200,000 draws, 5 % (their own scatter is 2 %)."""
    one = quantile_of_squares(np.diag([4.0, 0.0])[None], np.diag([9.0, 1.0]), 0.001)
    np.testing.assert_allclose(one, 36.0 * 10.827566, rtol=1e-6)
    equal = quantile_of_squares(2.0 * np.eye(3)[None], np.eye(3), 0.001)
    np.testing.assert_allclose(equal, 2.0 * 16.266236, rtol=1e-6)
    rng = np.random.default_rng(0)
    root = np.diag([1.0, 0.7, 0.4])
    draws = rng.standard_normal((200_000, 3)) @ root
    between = quantile_of_squares(np.eye(3)[None], root @ root, 0.01)
    assert between[0] == pytest.approx(np.quantile((draws**2).sum(axis=1), 0.99), rel=0.05)


def test_the_quantile_allows_for_a_size_that_is_estimated() -> None:
    """One offset whose size is that of three others: the quantile of F is 34.1."""
    exact = quantile_of_squares(np.eye(1)[None], 4.0 * np.eye(1), 0.01, freedom=3)
    np.testing.assert_allclose(exact, 4.0 * 34.1162, rtol=1e-5)


def judge_flight(
    folder, inertia: float, *, still: bool, drag: float = 0.0, looked_for: tuple[str, ...] = default_effects(),
    own: Mapping[str, float] = MappingProxyType({}), most: float = 0.15,
    more: Callable[[np.ndarray], np.ndarray] | None = None,
) -> ResidualExcess:  # fmt: skip
    """Return the residual excess of a test flight with drag after training flights without it; the inertia is off by a
    factor. ``own``: how large offsets of single flights seem, and ``most`` may be; ``more`` is felt along x in the
    last, at a time [s]."""
    body = replace(ROBOT.body, inertia=tuple(tuple(inertia * value for value in row) for row in ROBOT.body.inertia))
    robot: RobotCfg = replace(ROBOT, body=body)
    rng, flights = np.random.default_rng(0), []
    for seed in range(4):
        table = flight(60 + seed, drag=drag * (seed == 3), noise=0.1, seconds=8.0, rate=100.0)
        flown = uniform_flight(table, folder, str(seed))
        if still and seed < 3:
            rest = hover(f"{seed}", 5.0)
            assert rest.rotor_speed is not None
            flown = replace(
                rest,
                ang_vel=rest.ang_vel + 3e-4 * rng.standard_normal(rest.ang_vel.shape),
                specific_force=rest.specific_force + 5e-3 * rng.standard_normal((len(rest.time), 3)),
            )
        if seed == 3 and more is not None:
            flown = replace(flown, specific_force=flown.specific_force + np.outer(more(flown.time), [1.0, 0.0, 0.0]))
        flights.append(flown)
    train = make_predictor(flights[:3], robot, channels=find_channels(flights))
    test, channels = make_predictor(flights[3:], robot, channels=train.channels), train.channels
    declared = params_from_robot(robot)
    tolerance = tolerance_jacobian(train, declared)
    weights = inverse_variance_weights(train.residuals(declared))
    fit = linearise_at_params(train, (), declared, tolerance)
    squares = np.concatenate([(part**2).sum(axis=2) for part in tolerance]).mean(axis=0)
    columns = [
        NuisanceColumns(kind=OF_FLIGHTS, channel=name, columns=[], size=size, most=most) for name, size in own.items()
    ]
    offsets = prior_of_flight_offsets(columns, channels, weights.weight)
    chosen = replace(make_choice(make_fit()), weights=weights, tolerated=np.sqrt(squares))
    selection = make_selection(chosen, fit=fit, looked_for=looked_for, flight_offsets=offsets)
    floor = noise_floor(robot, test.flights, declared, channels, bandwidth=10.0)
    rms = np.sqrt(np.mean(np.square(np.concatenate(test.residuals(declared))), axis=0))
    after = make_evaluation(*rms.tolist(), channels=channels)
    return find_residual_excess(train, test, selection, (declared, declared), after, floor)


def test_what_training_at_rest_does_not_show_is_neither_noise_nor_unexplained(tmp_path) -> None:
    with one_thread():
        result = judge_flight(tmp_path, 1.1, still=True)
        assert result.channels == ()
        assert set(result.left_open) & INERTIA
        moved = judge_flight(tmp_path, 1.1, still=False)
    assert (moved.channels, moved.left_open) == ((), ())


def test_a_parameter_is_no_surer_on_test_flights_than_its_interval(tmp_path) -> None:
    flown = uniform_flight(flight(60, drag=0.2, noise=0.1, seconds=8.0, rate=100.0), tmp_path)
    predictor = make_predictor([flown], tolerances=Tolerances(acc_bias=1e-6))
    params = ModelParams(effects={"rotor_drag": np.full(3, 0.2)})
    fit = linearise_at_params(predictor, ("rotor_drag",), params, tolerance_jacobian(predictor, params))
    weights = inverse_variance_weights(predictor.residuals(params))
    chosen = replace(make_choice(make_fit()), weights=weights)
    selection = make_selection(chosen, flight_offsets=prior_of_flight_offsets((), predictor.channels, weights.weight))

    def limit(std: float) -> np.ndarray:
        spread = make_spread(np.array([0]), np.zeros((1, 1)), np.array([[std**2]]))
        within, whole = largest_open_squares(predictor, params, replace(selection, fit=fit, spread=spread))
        np.testing.assert_allclose(within, whole, rtol=1e-9)
        return within

    none, some, more = limit(0.0), limit(10.0), limit(20.0)
    assert some[0] > 10.0 * none[0]
    assert more[0] / some[0] == pytest.approx(4.0, rel=1e-3)
    np.testing.assert_allclose(more[3:6], none[3:6], rtol=0.3)


def test_what_no_tolerance_covers_is_open_to_the_effect_that_training_does_not_show(tmp_path, monkeypatch) -> None:
    """An inertia that is off by 25 %: more than tolerances, and ``inertia_error`` would make it, which rest does not show.
    A candidate without a finite linearisation on one kind of flights is left out."""

    absences = iter(((), ("slung_payload",)))  # training, test

    def linearise(*args):
        absent = next(absences)
        return [one for one in linearise_candidates(*args) if one.name not in absent]

    monkeypatch.setattr(predictive, "linearise_candidates", linearise)
    with one_thread():
        result = judge_flight(tmp_path, 1.25, still=True)
    assert set(result.channels) & INERTIA
    assert set(result.open_to[:2]) == {"inertia_error", "arm_length"}
    monkeypatch.undo()
    with one_thread():
        asked = judge_flight(tmp_path, 1.25, still=True, looked_for=("rotor_drag",))
    assert "inertia_error" not in asked.open_to


@pytest.mark.slow
def test_an_offset_as_large_as_those_of_other_flights_is_open_and_what_moves_is_not(tmp_path) -> None:
    """0.2 m/s² along x in the test flight alone: nothing new where offsets of flights scatter by 0.1, and they move nothing."""
    with one_thread():
        own, shifted = {"specific_force": 0.1}, lambda time: np.full(time.size, 0.2)
        alone = judge_flight(tmp_path, 1.0, still=False, more=shifted)
        as_others = judge_flight(tmp_path, 1.0, still=False, more=shifted, own=own)
        moving = judge_flight(tmp_path, 1.0, still=False, more=lambda time: 0.3 * np.sin(5.0 * time), own=own)
    assert "specific_force.x" in alone.channels
    assert (as_others.channels, as_others.left_open) == ((), ())
    assert as_others.of_flights == ("specific_force.x",)
    assert "specific_force.x" in moving.channels


@pytest.mark.slow
def test_offsets_that_are_alike_by_chance_say_little_and_none_is_larger_than_it_may_be(tmp_path) -> None:
    """0.15 m/s² in the test flight beside 0.03 on three axes of three others is no news, unless 0.02 is the most.

    The quantile of F with 1 and 6 degrees of freedom is 35.5: offsets up to 0.18 m/s² occur once in a thousand times.
    """
    own, more = {"specific_force": 0.03}, lambda time: np.full(time.size, 0.15)
    with one_thread():
        few = judge_flight(tmp_path, 1.0, still=False, more=more, own=own)
        bounded = judge_flight(tmp_path, 1.0, still=False, more=more, own=own, most=0.02)
    assert (few.channels, few.of_flights) == ((), ("specific_force.x",))
    assert "specific_force.x" in bounded.channels


@pytest.mark.slow
def test_what_training_shows_is_not_open(tmp_path) -> None:
    """A drag of the test flights alone, 1 N s/m, after training that moves without any: training rules every effect out."""
    with one_thread():
        result = judge_flight(tmp_path, 1.0, still=False, drag=1.0)
    assert "specific_force.x" in result.channels
    assert result.open_to == ()
    with one_thread():
        rested = judge_flight(tmp_path, 1.0, still=True, drag=1.0)
    assert "rotor_drag" in rested.open_to


def linear_fit(residual: np.ndarray, jacobian: np.ndarray, *, num_effect_params: int) -> ModelFit:
    """Return a fit of one flight of 10 s, its effects' parameters in front."""
    rows, width = residual.shape[0], jacobian.shape[2]
    return ModelFit(
        effects=("rotor_drag",), params=ModelParams(effects={"rotor_drag": np.full(3, 0.2)}),
        moments=block_moments([np.linspace(0.0, 10.0, rows)], [residual], [jacobian], length=1.0),
        low=np.full(width, -9.0), high=np.full(width, 9.0), num_effect_params=num_effect_params,
    )  # fmt: skip


def test_the_model_that_is_judged_has_the_parameters_of_the_robot_file() -> None:
    """Single steps ask for another drag than the file holds, whose drag came from rollouts: the effects stay as they are
    written, and the deviations solve ``(J^T W J + 1) d = J^T W r`` beside them."""
    rng = np.random.default_rng(0)
    jacobian = rng.standard_normal((500, 2, 7))
    residual = jacobian @ np.array([0.5, -0.3, 0.2, 1.0, 0.0, -1.0, 2.0]) + 0.1 * rng.standard_normal((500, 2))
    weight, written = np.array([2.0, 0.5]), ModelParams(effects={"rotor_drag": np.array([0.21, 0.2, 0.19])})
    result = model_with_training_deviations(written, linear_fit(residual, jacobian, num_effect_params=3), weight)
    assert result.effects is written.effects
    root = np.sqrt(weight)[None, :, None]
    columns, values = (jacobian[:, :, 3:] * root).reshape(-1, 4), (residual * root[:, :, 0]).reshape(-1)
    expected = np.linalg.solve(columns.T @ columns + np.eye(4), columns.T @ values)
    np.testing.assert_allclose(result.deviation, expected, rtol=1e-10)


def test_what_remains_is_material_above_noise_and_tolerances() -> None:
    floor, tolerated = np.array([0.02, 0.02, 0.02]), np.array([0.02, 0.02, 0.2])
    rms = np.array([0.024, 0.06, 0.06])  # near the floor; above both; hidden by the tolerances
    assert is_material_excess(rms, floor, tolerated).tolist() == [False, True, False]
    assert is_material_excess(rms, None, tolerated).tolist() == [False, False, False]


ROWS, CHANNELS, PARAMETERS = 12, 2, 3


def make_remainder(jacobian: np.ndarray, residual: np.ndarray, precision: np.ndarray) -> ResidualSums:
    return ResidualSums(
        square=(residual**2).sum(axis=0), gradient=np.einsum("rck,rc->ck", jacobian, residual),
        product=np.einsum("rck,rcl->ckl", jacobian, jacobian), precision=precision,
    )  # fmt: skip


def test_the_density_is_that_of_a_normal_residual_with_unknown_parameters() -> None:
    """But for what noise alone has: ``r ~ N(0, 1/w + J A^-1 J^T)``, written out."""
    rng = np.random.default_rng(4)
    jacobian, residual = rng.normal(size=(ROWS, CHANNELS, PARAMETERS)), rng.normal(size=(ROWS, CHANNELS))
    root = rng.normal(size=(PARAMETERS, PARAMETERS))
    precision, weight = root @ root.T + np.eye(PARAMETERS), np.array([3.0, 0.4])
    noise = np.diag(np.tile(1.0 / weight, ROWS))
    flat, rows = residual.ravel(), jacobian.reshape(-1, PARAMETERS)
    whole = multivariate_normal(cov=noise + rows @ np.linalg.inv(precision) @ rows.T).logpdf(flat)
    alone = multivariate_normal(cov=noise).logpdf(np.zeros(flat.size))
    result = make_remainder(jacobian, residual, precision).log_density(weight)
    np.testing.assert_allclose(result, whole - alone, rtol=1e-10)


def test_what_training_knows_test_flights_cannot_move() -> None:
    rng = np.random.default_rng(5)
    jacobian, weight = rng.normal(size=(200, CHANNELS, PARAMETERS)), np.array([4.0, 4.0])
    residual = jacobian @ np.array([0.5, -1.0, 0.7]) + 0.5 * rng.normal(size=(200, CHANNELS))
    loose, tight = (make_remainder(jacobian, residual, k * np.eye(PARAMETERS)) for k in (1.0, 1e6))
    assert loose.log_density(weight) - tight.log_density(weight) > 100.0
    np.testing.assert_allclose(loose.joint_step(weight), [0.5, -1.0, 0.7], atol=0.1)
    assert np.abs(tight.joint_step(weight)).max() < 0.01


RATE, BAND = 30.0, 10.0
FORCE, TURN = Channel(kind="specific_force", axis="x"), Channel(kind="angular_acceleration", axis="x")


def low_passed(values: np.ndarray, *, derivative: bool = False) -> np.ndarray:
    """Return noise sampled at ten times the band, low-passed and decimated to three times the band as in a comparison."""
    return lowpass(values, 100.0, BAND, derivative=derivative)[::3][10:-10]


def test_noise_is_called_noise_as_often_as_stated() -> None:
    """400 residuals of two flights: p is uniform, also of a differentiated sensor."""
    rng = np.random.default_rng(0)
    result = []
    for _ in range(200):
        noise = [rng.standard_normal((1000, 1)) for _ in range(2)]
        both = [np.hstack((low_passed(n), low_passed(n, derivative=True))) for n in noise]
        times = [0.03 * np.arange(len(rows)) for rows in both]
        result += [w.probability for w in whiteness_of_channels(times, both, (FORCE, TURN), BAND)]
    for share in (0.05, 0.2, 0.5):
        scatter = 4.0 * np.sqrt(share * (1 - share) / 400) + 0.02
        assert np.mean(np.array(result) < share) == pytest.approx(share, abs=scatter)


@pytest.mark.parametrize("kind", ["line", "drift"])
def test_what_is_no_noise_is_told_and_where_it_lies(kind: str) -> None:
    rng, time = np.random.default_rng(1), 0.03 * np.arange(400)
    own = np.sin(2.0 * np.pi * 7.0 * time) if kind == "line" else np.sin(2.0 * np.pi * 0.3 * time)
    values = rng.standard_normal((400, 1)) + own[:, None]
    (result,) = whiteness_of_channels([time], [values], (FORCE,), BAND)
    assert result.probability < WHITE
    assert not result.white
    assert int(np.argmax(result.octaves)) == (3 if kind == "line" else 0)


def test_a_sine_lies_in_its_octave_with_its_power_and_gaps_split_flights() -> None:
    """``rows / 2`` of a sine of 4 Hz, undone for the gain of the low-pass there."""
    time = np.arange(300) / RATE
    frequency, power = periodogram_of_flights([time], [np.sin(2.0 * np.pi * 4.0 * time)[:, None]], BAND)
    octaves = power_by_octave(frequency, power, BAND)[:, 0]
    gain = 1.0 / (1.0 + 0.4**8)
    np.testing.assert_allclose(octaves, [0.0, 0.0, 300 / 4 / gain**2, 0.0], atol=1e-9)
    assert octave_ranges(BAND)[2] == "2.5 to 5 Hz"
    jump = np.where(time < 5.0, time, time + 3.0)
    split, _ = periodogram_of_flights([jump], [np.ones((300, 1))], BAND)
    assert split.min() == pytest.approx(RATE / 150)
