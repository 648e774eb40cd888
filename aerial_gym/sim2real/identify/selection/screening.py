"""Screening of many candidates: what each would gain if the model were linear in it, without fitting it.

The residual of the present model is linearised once; of each candidate only its own derivatives are needed, one prediction a
parameter. Full fits are then made of the candidates that look best. Letters: C channels, P parameters of the present model
and the candidate together, N tolerances.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.least_squares.covariance import uncertainty
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Frozen, effect_jacobian, fit_at
from aerial_gym.sim2real.identify.selection.scoring import Gain, LeftOut, Scored
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ScreenedCandidate:
    """One candidate as the linearised model sees it."""

    effect: str
    start: ModelParams
    """The present model with the candidate at its neutral parameters."""

    gain: Gain
    """Over the present model, on flights left out."""

    unidentified: bool
    """Whether the flights leave all its parameters unknown by more than their scale."""


class Screening:
    """The present model, linearised."""

    def __init__(self, predictor: Predictor, current: Scored, tolerance: list[Array], left_out: LeftOut) -> None:
        """Take a model with its squares on flights left out."""
        present = current.fit
        self._predictor, self._current, self._present = predictor, current, present
        self._tolerance, self._left_out = tolerance, left_out
        self._predicted = predictor.predict(present.point)
        self._own = effect_jacobian(predictor, present.point, present.effects, self._predicted)

    def screen(self, name: str, start: ModelParams, frozen: Frozen) -> ScreenedCandidate:
        """Return what a candidate would gain from ``start``."""
        predictor, effects = self._predictor, (*self._present.effects, name)
        predicted = predictor.predict(start)  # neutral need not be as declared: one lag in place of two
        more = effect_jacobian(predictor, start, (name,), predicted)
        jacobians = [np.concatenate(parts, axis=2) for parts in zip(self._own, more, self._tolerance, strict=True)]
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        fit = fit_at(predictor, effects, start, residuals, jacobians, frozen=frozen)
        scored = Scored(
            fit=fit,
            spread=uncertainty(fit, self._left_out.weights.weight),
            left_out=self._left_out.squares(fit),
        )
        gain = self._left_out.gain_beyond_tolerances(self._current, scored)
        own = [place for place, k in enumerate(scored.spread.columns) if k in fit.columns_of(name)]
        unidentified = bool(np.all(np.diag(scored.spread.plain)[own] > 1.0))
        return ScreenedCandidate(effect=name, start=start, gain=gain, unidentified=unidentified)
