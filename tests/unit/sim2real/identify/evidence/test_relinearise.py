"""Refits of a set with the tolerances linearised about itself, from fits that are written down, and secant derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.evidence.relinearise import MOST_TURNS, refit_until_settled
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    correct_sparse_columns,
    join_columns,
    split_columns,
)
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.set_fits import FitStub, make_fit


@pytest.mark.parametrize(
    ("deviations", "turns"),
    [
        ((0.0, 0.4), 1),
        ((0.0, 1.4, 1.8), 2),
        ((0.0, 1.0, 0.4, 1.0, 0.4, 1.0), MOST_TURNS),
        ((0.0, 1.0, 0.4, 2.0), 2),
        ((0.0, 1.4, None), 2),
    ],
    ids=["stays", "moves once", "never stays", "leads away", "goes nowhere"],
)
def test_a_set_is_fitted_about_itself_until_its_deviations_stay(deviations, turns) -> None:
    fits = [replace(make_fit(), deviation=np.zeros(0) if one is None else np.array([one, 0.2])) for one in deviations]
    result, fitter, about = refit_about_own_models(fits)
    assert result is fits[turns]
    assert fitter == turns
    assert 0 < len(about) <= len(fits)
    for params, one in zip(about, fits, strict=False):
        np.testing.assert_array_equal(params.deviation, one.deviation)


@pytest.mark.parametrize(
    ("logs", "turns"),
    [((-100.0, -50.0, -45.0, -44.0), 2), ((-100.0, -500.0, -5.0), 1), ((-100.0, -9.0, -8.0), 3)],
    ids=["gains too little", "loses", "comes near"],
)
def test_a_set_that_stays_out_of_reach_is_not_fitted_about_itself_again(logs, turns) -> None:
    """A gain of 50 may repeat and reach -10; one of 5 from -45 may not."""
    deviations = np.cumsum([0.0, 3.0, 2.0, 1.0])
    fits = [replace(make_fit(log=log), deviation=np.array([one])) for log, one in zip(logs, deviations, strict=False)]
    fits.append(replace(fits[-1]))  # its deviations have settled
    assert refit_about_own_models(fits, least=-10.0)[0] is fits[turns]


@pytest.mark.parametrize(
    ("deviations", "logs", "turns"),
    [
        ((0.0, 1.0, 0.4, 1.0, 0.3), (0.0, -40.0, -20.0, -60.0, -50.0), 2),
        ((0.0, 1.4, 1.8), (0.0, -20.0, -60.0), 2),
    ],
    ids=["never stays", "stays"],
)
def test_of_turns_that_do_not_settle_the_most_probable_one_is_kept(deviations, logs, turns) -> None:
    """A settled turn counts even if it is less probable: the tolerances of others are linear about a distant model."""
    pairs = zip(deviations, logs, strict=True)
    fits = [replace(make_fit(log=log), deviation=np.array([one, 0.2])) for one, log in pairs]
    result, fitter, _ = refit_about_own_models(fits)
    assert result is fits[turns]
    assert fitter == turns


def refit_about_own_models(fits: list[EffectSetFit], **options: float) -> tuple[EffectSetFit, int, list[ModelParams]]:
    """Return the result of refits that give some fits in turn, the number of its fitter, and the models of all fitters."""
    number, about = 0, list[ModelParams]()

    class Refits(FitStub):
        weights = None

        def refit_from_other_fitter(self, before: EffectSetFit, *_: object) -> EffectSetFit:
            nonlocal number
            assert before is fits[number]
            number += 1
            return fits[number]

        def clear_nuisance_sums(self) -> None:
            pass

    fitters = [Refits() for _ in fits]

    def fitter_at_model(params: ModelParams, _: object) -> Fitter:
        about.append(params)
        return fitters[len(about)]

    result, fitter, _ = refit_until_settled(fits[0], fitters[0], fitter_at_model, **options)
    return result, fitters.index(fitter), about


@pytest.mark.parametrize(("log", "reached"), [(-40.0, False), (-9.0, True)])
def test_a_set_that_cannot_reach_a_log_posterior_says_so(log: float, reached: bool) -> None:
    fits = [replace(make_fit(log=one), deviation=np.zeros(1)) for one in (-41.0, log)]
    fitter = FitStub()
    fitter.weights, fitter.refit_from_other_fitter = None, lambda *_: fits[1]
    assert refit_until_settled(fits[0], fitter, lambda *_: fitter, least=-10.0)[2] == reached


def test_corrected_columns_give_the_change_and_stay_zero_elsewhere() -> None:
    """Schubert's update: of the columns of a channel, each takes its share of the missed change by its own step."""
    rng = np.random.default_rng(0)
    dense = [rng.standard_normal((rows, 3, 4)).astype(np.float32) for rows in (5, 7)]
    for part in dense:
        part[:, 0, :2] = part[:, 1, 2:] = part[:, 2] = 0.0
    change, step = [rng.standard_normal((rows, 3)) for rows in (5, 7)], np.array([0.0, 2.0, 1.0, -0.5])
    results = join_columns(correct_sparse_columns(split_columns(dense), step, change), 3)
    for before, after, wanted in zip(dense, results, change, strict=True):
        np.testing.assert_allclose((after @ step)[:, :2], wanted[:, :2], atol=1e-5)
        np.testing.assert_array_equal(after[before == 0.0], 0.0)
        np.testing.assert_array_equal(after[:, :, 0], before[:, :, 0])  # no step along it
        moved = (after - before)[:, 0]
        np.testing.assert_allclose(moved[:, 2], -2.0 * moved[:, 3], rtol=1e-3, atol=1e-5)
