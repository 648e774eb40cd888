"""Predictive density of the test flights under rivals of the named effects.

Test flights may excite motions that training flights lack. The residual r of a set of effects at its most probable parameters
follows ``r = J d + noise``. The error d of its parameters is normal with the covariance ``A^-1`` of the training flights. So
the log density is ``-1/2 (r W r - h (A + B)^-1 h) - 1/2 log det(1 + A^-1 B)`` plus a constant that all sets share,
with ``B = J W J`` and ``h = J W r``. Test flights can make a named effect doubtful, but never name one.
Letters: C channels, K parameters (those of effects in units of their scale, then the deviations in standard deviations).

Source: Box (1980), Sampling and Bayes' inference in scientific modelling and robustness, J. R. Statist. Soc. A 143 (predictive
densities of data that were not used).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.parameters import is_continuous_parameter
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.predictive import PASSES
from aerial_gym.sim2real.predict.predictor import Predictor


def selection_with_test_odds(selection: SelectionResult, test: Predictor) -> SelectionResult:
    """Return the selection with the log odds that the test flights add to each rival of a named effect, at least 0."""
    rivals = {one.fitted.label: one.fitted for name in selection.effects for one in selection.effect_rivals(name)}
    if not rivals:
        return selection
    densities = log_densities(test, [selection.named, *rivals.values()], selection)
    gain = (densities[1:] - densities[0]) / selection.best.parameter_overdispersion
    return replace(selection, doubt=dict(zip(rivals, np.maximum(gain, 0.0).tolist(), strict=True)))


def notes_on_doubt(selection: SelectionResult) -> list[Finding]:
    """Return a note on each rival that is tied only because of the test flights."""
    return [
        Finding("doubt_by_test", name, {"other": rival.effect, "log_odds": rival.log_odds - rival.doubt})
        for name in selection.effects
        for rival in selection.effect_ties(name)
        if rival.is_clearly_less_probable_in_training
    ]


@dataclass(frozen=True)
class ResidualSums:
    """Sums over the rows of the test flights of a set's residual r and Jacobian J, and its precision in training."""

    square: Array  # ``r r``, (C,)
    gradient: Array  # ``J r``, (C, K)
    product: Array  # ``J J``, (C, K, K)
    precision: Array  # A, (K, K)

    def joint_step(self, weight: Array) -> Array:
        """Return the parameter step that fits training and test flights together, (K,)."""
        joint = self.precision + np.tensordot(weight, self.product, axes=1)
        return np.linalg.solve(joint, weight @ self.gradient)

    def squares_after_step(self, step: Array) -> Array:
        """Return the sum of squared residuals of each channel after a parameter step, (C,)."""
        return self.square - 2.0 * self.gradient @ step + np.einsum("k,ckl,l->c", step, self.product, step)

    def log_density(self, weight: Array) -> float:
        """Return the predictive log density of the test flights, without the constant shared by all sets."""
        step, seen = self.joint_step(weight), np.tensordot(weight, self.product, axes=1)
        surer = np.linalg.slogdet(self.precision + seen)[1] - np.linalg.slogdet(self.precision)[1]
        return -0.5 * float(weight @ self.square - (weight @ self.gradient) @ step + surer)


def log_densities(test: Predictor, fits: Sequence[EffectSetFit], selection: SelectionResult) -> Array:
    """Return the predictive log density of the test flights under each of M sets, up to a shared constant, (M,).

    The weight of a channel is limited by the smallest mean square that any set leaves in it.
    """
    weights, sums = selection.weights, [residual_sums(test, one, selection) for one in fits]
    rows, weight = sum(time.size for time in test.times), weights.weight
    for _ in range(PASSES):
        least = np.min([one.squares_after_step(one.joint_step(weight)) for one in sums], axis=0) / rows
        weight = weights.weight_below_limit(least)
    return np.array([one.log_density(weight) for one in sums])


def residual_sums(test: Predictor, fitted: EffectSetFit, selection: SelectionResult) -> ResidualSums:
    """Return the residual sums of a set on the test flights at its most probable model, without offsets of flights."""
    at, offsets = fitted.model_with_deviations, selection.flight_offsets
    predicted = test.predict(at)
    tolerance = tolerance_jacobian(test, at)
    columns = effect_jacobian(test, at, fitted.effects, predicted, beside=tolerance)
    owners = [(name, place) for name in fitted.effects for place in range(len(EFFECTS.get(name).parameters))]
    own = [k for k, owner in enumerate(owners) if is_continuous_parameter(*owner)]
    kept = np.array([*own, *range(len(owners), len(owners) + test.num_tolerances)])
    jacobian = np.concatenate(offsets.remove_offsets([part[:, :, kept] for part in columns]))
    left = np.concatenate(offsets.remove_offsets([m - p for m, p in zip(test.measured, predicted, strict=True)]))
    gradient = np.einsum("rck,rc->ck", jacobian, left)
    product = np.stack([jacobian[:, c].T @ jacobian[:, c] for c in range(left.shape[1])])
    precision = np.linalg.inv(fitted.parameters.covariance[: kept.size, : kept.size])
    return ResidualSums(np.square(left).sum(axis=0), gradient, product, precision)
