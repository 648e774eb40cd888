"""Gusts in what is left over: the process, its moments and likelihood, and everything that must not be called gusts. Series
are drawn from the spectrum (sums of cosines), not by the recursion that the simulator and the plant use."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import integrate
from scipy.linalg import cholesky, solve_triangular, toeplitz
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from aerial_gym.config.robot import RobotCfg
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit
from aerial_gym.sim2real.identify.least_squares.derivatives import rms_caused_by_tolerances, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import linearise_at_params
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.judge.outcome import Decision
from aerial_gym.sim2real.judge.random_wind.gusts import RandomWind, find_random_wind, random_wind_in_file, wind_response
from aerial_gym.sim2real.judge.random_wind.ornstein_uhlenbeck import (
    WindSeries,
    axis_covariances,
    covariance_of_filtered_process,
    fit_process,
    log_likelihoods,
    p_value_of_autocorrelation,
    p_value_of_noise,
    p_values_of_rivals,
    std_of_logarithms,
    whiten_rows,
)
from aerial_gym.sim2real.judge.remainder import are_gusts_sufficient
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.logs.signals import lowpass_gain
from aerial_gym.sim2real.predict.model_params import ModelParams, params_from_robot
from tests.unit.sim2real.flat_flights import ROBOT, make_predictor
from tests.unit.sim2real.predict.test_scene import RATE, hover
from tests.unit.sim2real.set_fits import make_choice, make_fit, make_selection

BAND, STEP, ROWS = 10.0, 0.1, 120
TIME = STEP * np.arange(ROWS)


def draw_wind(rng: np.random.Generator, time: np.ndarray, std: float, corr_time: float) -> np.ndarray:
    """Return a low-passed wind (T, 3): cosines of random phase, amplitude sqrt(2 S df) H, lines every 1 / 80 s."""
    frequency = (np.arange(2400) + 0.5) / 80.0
    density = 4.0 * corr_time * std**2 / (1.0 + (2.0 * np.pi * frequency * corr_time) ** 2)
    size = np.sqrt(density / 80.0) * lowpass_gain(frequency, BAND)
    wave = 2.0 * np.pi * np.outer(time, frequency)
    cosine, sine = rng.standard_normal((2, frequency.size, 3)) * size[:, None]
    return np.cos(wave) @ cosine + np.sin(wave) @ sine


def series(change: Callable[[int], np.ndarray] | None = None, *, std: float = 1.0, seed: int = 0) -> WindSeries:
    """Return four flights of wind with white noise of 0.05 m/s, and what ``change`` adds to a flight."""
    rng = np.random.default_rng(seed)
    wind, features = [], []
    for flight in range(4):
        place = np.cumsum(0.3 * rng.standard_normal((ROWS, 3)), axis=0)
        features.append(place)
        wind.append(draw_wind(rng, TIME, std, 1.0) + 0.05 * rng.standard_normal((ROWS, 3)))
        if change is not None:
            wind[-1] = wind[-1] + change(flight)
    return WindSeries(wind=wind, features={"position": features}, step=STEP, bandwidth=BAND)


@pytest.mark.parametrize("corr_time", [0.1, 0.7, 5.0])
def test_the_covariance_is_that_of_the_spectrum_below_the_band(corr_time: float) -> None:
    """Against adaptive quadrature of ``int S H² cos(2 pi f t) df``."""

    def density(f: float, lag: float) -> float:
        shape = 4.0 * corr_time / (1.0 + (2.0 * np.pi * f * corr_time) ** 2)
        return shape * float(lowpass_gain(np.array([f]), BAND)[0]) ** 2 * np.cos(2.0 * np.pi * f * lag)

    lags = np.array([0.0, 0.1, 0.5])
    expected = [integrate.quad(density, 0.0, 30.0, args=(lag,), limit=400)[0] for lag in lags]
    np.testing.assert_allclose(covariance_of_filtered_process(corr_time, BAND, lags), expected, atol=2e-3)


def test_std_and_correlation_time_are_found_within_their_spread() -> None:
    """Over six draws of four 12 s flights: the mean within three standard errors, the scatter as stated within a factor 2."""
    result, spread = [], []
    for seed in range(6):
        wind = series(std=0.8, seed=seed)
        fit = fit_process(wind)
        result.append(np.log([fit.std / 0.8, fit.corr_time / 1.0]))
        spread.append(std_of_logarithms(wind, fit) if seed == 0 else spread[-1])
    stated = np.mean(spread, axis=0)
    assert np.all(np.abs(np.mean(result, axis=0)) < 3.0 * stated / np.sqrt(6.0))
    assert np.all(np.std(result, axis=0) < 2.0 * stated)
    assert np.all(np.std(result, axis=0) > 0.5 * stated)


def test_wind_alone_raises_no_objection_and_is_no_noise() -> None:
    wind = series(seed=3)
    fit = fit_process(wind)
    p_values = p_values_of_rivals(wind, fit)
    assert min(p_values.values()) > 0.001, p_values
    assert p_value_of_noise(wind, fit) < 1e-6
    quiet = replace(wind, wind=[0.05 * np.random.default_rng(f).standard_normal((ROWS, 3)) for f in range(4)])
    assert p_value_of_noise(quiet, fit_process(quiet)) > 0.01


def test_wind_whose_vertical_is_weaker_and_faster_is_found_as_such() -> None:
    """Over 4 flights: within three standard deviations of 0.4 of the intensity and half the correlation time."""
    wind = series()
    rng = np.random.default_rng(8)
    for flight in wind.wind:
        flight[:, 2] = draw_wind(rng, TIME, 0.4, 0.5)[:, 2] + 0.05 * rng.standard_normal(ROWS)
    fit = fit_process(wind)
    spread = std_of_logarithms(wind, fit)
    truth = (1.0, 1.0, 0.4, 0.5)
    for value, true, std in zip((fit.std, fit.corr_time, *fit.vertical), truth, spread, strict=True):
        assert abs(np.log(value / true)) < 3.0 * std
    assert fit.gain > 20.0
    assert min(p_values_of_rivals(wind, fit).values()) > 0.001
    assert fit_process(series()).vertical == ()


@pytest.mark.parametrize(("reason", "change"), [
    ("line", lambda f: 0.3 * np.sin(2.0 * np.pi * 3.1 * TIME + f)[:, None] * [1.0, 0.0, 0.0]),
    ("axes", lambda f: draw_wind(np.random.default_rng(9 + f), TIME, 3.0, 1.0) * [1.0, 0.0, 0.0]),
    ("flights", lambda f: (f == 2) * draw_wind(np.random.default_rng(9), TIME, 4.0, 1.0)),
    ("shape", lambda f: 6.0 * (np.abs(TIME - 4.0 - f) < 0.06)[:, None] * [1.0, 1.0, 1.0]),
    ("memory", lambda f: 3.0 * np.sin(np.outer(2.0 * TIME, [1.0, 1.3, 1.7]) + 5.0 * np.sin(0.7 * TIME + f)[:, None])),
])  # fmt: skip
def test_what_is_no_random_wind_is_told_apart(reason: str, change: Callable[[int], np.ndarray]) -> None:
    wind = series(change)
    assert p_values_of_rivals(wind, fit_process(wind))[reason] < 0.001


def test_wind_beside_an_offset_of_each_flight_that_turns_with_the_body_is_no_other_process() -> None:
    """Offsets of 0.2 to 0.4 m/s² of the force, seen by a drag of 0.2 1/s in a body that tilts by up to half a radian."""
    tilt = [0.5 * np.sin(3.0 * TIME + f) for f in range(4)]
    turns = [Rotation.from_rotvec(np.outer(own, [0.6, 0.8, 0.0])).as_matrix() for own in tilt]
    sizes = np.outer((0.2, 0.3, 0.4, 0.3), (0.0, 0.0, 1.0))
    wind = series(seed=4)
    moved = [w + turn @ size / 0.2 for w, turn, size in zip(wind.wind, turns, sizes, strict=True)]
    wind = replace(wind, wind=moved, features={"attitude": [turn[:, :, 2] for turn in turns]})
    assert p_values_of_rivals(wind, fit_process(wind))["attitude"] < 0.001
    wind = replace(wind, offsets=[turn / 0.2 for turn in turns])
    assert min(p_values_of_rivals(wind, fit_process(wind)).values()) > 0.001


def test_a_force_that_follows_a_feature_is_told_apart() -> None:
    wind = series(seed=5)
    moved = [w + 0.6 * x[:, :1] * [1.0, 0.0, 0.0] for w, x in zip(wind.wind, wind.features["position"], strict=True)]
    wind = replace(wind, wind=moved)
    assert p_values_of_rivals(wind, fit_process(wind))["position"] < 0.001


DRAGGED = ModelParams(effects={"rotor_drag": np.array([0.3, 0.24, 0.18])})
IN_AIR = replace(ROBOT, effects={"rotor_drag": {"dx": 0.3, "dy": 0.24, "dz": 0.18}}, effects_source="flown with it")


@cache
def fly_in_wind(number: int, std: float = 0.0, *, gain: float = np.inf) -> Flight:
    """Return a hovering flight whose accelerometer feels a wind through the drag: ``f = d (w - v) / m`` along each axis.

    A velocity v is controlled with ``v' = f - gain v``, so that it answers the wind; an infinite gain holds the place.
    """
    rng = np.random.default_rng(number)
    time = np.arange(round(12.0 * RATE)) / RATE
    still = hover(str(number), 1.0)
    wind, drag, zeros = draw_wind(rng, time, std, 1.0), np.array([0.5, 0.4, 0.3]), np.zeros((time.size, 3))
    velocity = np.zeros((time.size, 3))
    for row in range(1, time.size if np.isfinite(gain) else 0):
        push = drag * (wind[row - 1] - velocity[row - 1]) - gain * velocity[row - 1]
        velocity[row] = velocity[row - 1] + push / RATE
    felt = drag * (wind - velocity) + 0.02 * rng.standard_normal((time.size, 3))
    return replace(
        still, time=time, position=np.cumsum(velocity, axis=0) / RATE + 1.0, lin_vel=velocity, ang_vel=zeros,
        attitude=np.tile([0.0, 0.0, 0.0, 1.0], (time.size, 1)),
        rotor_speed=np.tile(still.rotor_speed[0], (time.size, 1)), specific_force=felt + np.array([0.0, 0.0, 9.81]),
    )  # fmt: skip


def in_steady_wind(number: int, speed: float) -> Flight:
    """Return a flight in gusts and a wind along world x, with the heading turned by as many quarters as its number."""
    gusty, turn = fly_in_wind(number, 1.2, gain=2.0), Rotation.from_euler("z", 0.5 * np.pi * number)
    along = turn.apply([speed, 0.0, 0.0], inverse=True) * np.array([0.5, 0.4, 0.3])
    attitude = np.tile(turn.as_quat(), (gusty.time.size, 1))
    return replace(
        gusty, attitude=attitude, specific_force=gusty.specific_force + along,
        lin_vel=0.0 * gusty.lin_vel, position=0.0 * gusty.position + 1.0,
    )  # fmt: skip


def look(flights: list[Flight], params: ModelParams = DRAGGED, **more: object) -> RandomWind:
    predictor = make_predictor(flights)
    count = len(predictor.channels)
    settings = {"floor": np.full(count, 0.01), "tolerated": np.full(count, 0.01), "remaining": np.ones(count, bool)}
    return find_random_wind(predictor, params, Criteria(), **settings | more)


def test_a_wind_is_seen_through_the_drag_of_the_model() -> None:
    flights = [fly_in_wind(number, 1.2) for number in range(3)]
    predictor = make_predictor(flights)
    response = wind_response(predictor, DRAGGED)[0][:, :3]
    np.testing.assert_allclose(response, np.tile(np.diag([0.5, 0.4, 0.3]), (len(response), 1, 1)), atol=1e-6)
    result = look(flights)
    assert result.is_accepted, result.objections
    for value, truth, spread in zip(result.params().values(), (1.2, 1.0), result.spread, strict=True):
        assert abs(np.log(value / truth)) < 3.0 * spread
    added = result.channel_rms(predictor, DRAGGED)[:3]
    share = np.sqrt(covariance_of_filtered_process(result.corr_time, BAND, np.zeros(1))[0])
    expected = result.std * np.array([0.5, 0.4, 0.3]) * share
    np.testing.assert_allclose(added, expected, rtol=1e-6)
    named = result.as_effect(ROBOT)
    assert (named.name, named.params) == ("gusts", result.params())
    assert named.confidence > 0.999
    assert [note.code for note in result.notes] == ["gusts_are_random", "law_preferred"]
    assert result.notes[1].values["log_odds"] > 0.0


def test_motion_that_answers_the_wind_is_no_objection_to_it() -> None:
    """Within a row of 0.1 s the velocity grows with the gust, so that gusts seemed to follow the velocity (p = 1e-23)."""
    result = look([fly_in_wind(number, 1.2, gain=2.0) for number in range(4)])
    assert result.is_accepted, result.objections


def sufficient(
    flights: list[Flight], robot: RobotCfg = IN_AIR, best: EffectSetFit | None = None,
    left: list[Flight] | None = None,
) -> bool:  # fmt: skip
    """Return whether gusts suffice for some training flights in place of a selected centre of mass.

    With it, the residual is that of the flights ``left``; of ``flights`` if not given.
    """
    predictor, params = make_predictor(flights, robot), params_from_robot(robot)
    tolerance = tolerance_jacobian(predictor, params, np.float32)
    tolerated = rms_caused_by_tolerances(tolerance, robot.num_rotors)
    variance = np.mean(np.square(np.concatenate(predictor.residuals(params))), axis=0) + 1e-4
    weights = Weighting(variance=variance, effective=np.full(variance.size, 0.2))  # gusts are coloured
    chosen = replace(make_choice(best or make_fit("com_offset")), weights=weights, tolerated=tolerated)
    remaining = predictor if left is None else make_predictor(left, robot)
    selection = replace(make_selection(chosen), fit=linearise_at_params(remaining, (), params, tolerance))
    return are_gusts_sufficient(predictor, params, selection)


@pytest.mark.slow
def test_gusts_suffice_only_if_no_other_cause_acts_beside_them() -> None:
    """A mean wind of 2 m/s, a thrust that is off by 6 % and a torque are no gusts, nor those that the robot file declares."""
    gusty = [fly_in_wind(number, 1.2, gain=2.0) for number in range(4)]
    assert sufficient(gusty)
    assert not sufficient(gusty, best=make_fit())
    assert not sufficient([fly_in_wind(number) for number in range(2)])
    declared = {**IN_AIR.effects, "gusts": {"std": 1.2, "corr_time": 1.0}}
    assert not sufficient(gusty, replace(IN_AIR, effects=declared))
    steady = np.array([1.0, 0.0, 0.0])
    assert not sufficient([replace(one, specific_force=one.specific_force + steady) for one in gusty])
    assert not sufficient([replace(one, rotor_speed=0.97 * one.rotor_speed) for one in gusty])
    assert sufficient([in_steady_wind(number, 0.0) for number in range(4)])
    assert not sufficient([in_steady_wind(number, 2.0) for number in range(4)])  # its mean along body axes is zero
    turning = [replace(one, ang_vel=np.outer(np.sin(6.0 * one.time), [1.0, 0.0, 0.0])) for one in gusty]
    assert not sufficient(turning)
    assert not sufficient(gusty, left=[fly_in_wind(number) for number in range(4)])  # the effects explain all of it


def test_where_gusts_are_not_looked_for_and_why() -> None:
    flights = [fly_in_wind(number) for number in range(2)]
    assert look(flights, ModelParams()).untestable == Finding("gusts_no_drag", "gusts")
    assert look(flights, floor=None).untestable == Finding("gusts_no_floor", "gusts")
    blind = [replace(f, lin_vel=None) for f in flights]
    assert look(blind).untestable == Finding("gusts_no_forces", "gusts")
    empty = look(flights, remaining=np.zeros(12, dtype=bool))
    assert (empty.is_accepted, empty.untestable, empty.notes) == (False, None, ())
    still = look(flights)
    assert not still.is_accepted
    (note,) = still.notes
    assert note.code == "gusts_refused"
    assert len(note.values["objections"]) == len(still.objections) > 0


def test_declared_gusts_are_taken_as_they_are() -> None:
    declared = random_wind_in_file(replace(ROBOT, effects={"gusts": {"std": 0.5, "corr_time": 2.0}}))
    assert declared.is_accepted
    assert declared.params() == {"std": 0.5, "corr_time": 2.0}
    assert not random_wind_in_file(ROBOT).is_accepted
    calm = {"std": 0.5, "corr_time": 2.0, "vertical": 0.4, "vertical_time": 0.3}
    assert random_wind_in_file(replace(ROBOT, effects={"gusts": calm})).params() == calm


def test_noise_has_no_memory_as_often_as_stated() -> None:
    """Series of 170 rows without their mean, of four flights; 20 lags, two of which a fit would have taken."""
    rng = np.random.default_rng(0)
    p_values = []
    for _ in range(600):
        parts = [rng.standard_normal((170, 3)) for _ in range(4)]
        p_values.append(p_value_of_autocorrelation([part - part.mean(axis=0) for part in parts]))
    assert np.mean(np.array(p_values) < 0.01) < 0.035
    late = [np.roll(part, 3, axis=0) for part in parts]
    assert p_value_of_autocorrelation([part + 0.2 * other for part, other in zip(parts, late, strict=True)]) < 1e-4


def test_gusts_beside_a_verdict_are_a_candidate_of_it() -> None:
    wind = RandomWind(std=1.0, p_value=1e-9)
    point = Finding("left_open", "", {"channels": ["specific_force.x"]})

    def decision(kind: str, *candidates: str) -> Decision:
        return Decision(kind=kind, candidates=candidates, findings=(point,))

    none, open_yet, more = (
        wind.decision(decision(*given)) for given in (("none",), ("not shown",), ("unexplained", "rotor_drag"))
    )
    codes = [one.code for one in none.findings]
    assert (none.kind, none.candidates, codes) == ("explained", ("gusts",), ["gusts_reach_floor"])
    assert (open_yet.kind, open_yet.findings) == ("explained", (point,))
    assert (more.kind, more.candidates, more.findings) == ("unexplained", ("rotor_drag", "gusts"), (point,))
    refused = replace(wind, objections=(Finding("may_be_noise", "gusts", {"p_value": 0.1}),))
    assert refused.decision(decision("none")) == decision("none")


RNG = np.random.default_rng(0)


def make_series(*rows: int) -> WindSeries:
    return WindSeries(wind=[RNG.normal(size=(n, 3)) for n in rows], features={}, step=0.1, bandwidth=8.0)


def test_rows_are_whitened_as_by_the_cholesky_factor() -> None:
    """L^-1 y with C = L L^T, and the diagonal of L: the innovations of a process and their std."""
    covariance = axis_covariances(make_series(40), 0.7, 1.3, np.array([0.1, 0.3, 0.5]))
    values = RNG.normal(size=(3, 40, 2))
    white, variance = whiten_rows(covariance, values)
    for first, columns, result, square in zip(covariance, values, white, variance, strict=True):
        root = cholesky(toeplitz(first), lower=True)
        np.testing.assert_allclose(result, solve_triangular(root, columns, lower=True), rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(np.sqrt(square), np.diag(root), rtol=1e-10)


def test_the_likelihood_is_that_of_differences_from_the_mean() -> None:
    """Restricted likelihood: of any N - 1 contrasts, up to a constant that no parameter enters; flights and axes add up."""
    series = make_series(12, 20)
    processes = [(0.5, 0.8, np.array([0.2, 0.3, 0.4])), (0.9, 2.0, np.array([0.1, 0.2, 0.6]))]
    expected = np.zeros(2)
    for place, process in enumerate(processes):
        for axis, first in enumerate(axis_covariances(series, *process)):
            for wind in series.wind:
                contrasts = np.diff(np.eye(len(wind)), axis=0)
                whole = contrasts @ toeplitz(first[: len(wind)]) @ contrasts.T
                expected[place] += multivariate_normal(cov=whole).logpdf(contrasts @ wind[:, axis])
    result = log_likelihoods(series, processes)
    assert result[1] - result[0] == pytest.approx(expected[1] - expected[0], rel=1e-8)
