"""What test flights say of rivals of the named effects: where training flights do not move, test flights tell more.

Given training, ``r = J d + noise`` on the test flights, with r what a set of effects leaves of them at its most probable
parameters and d, of effects and tolerances, normal of the covariance ``A^-1`` that training leaves. So the log density of the
test flights is ``-1/2 (r W r - h (A + B)^-1 h) - 1/2 log det(1 + A^-1 B)`` with ``B = J W J`` and ``h = J W r``, but for
what all sets have alike. Nothing is taken from it: test flights bring doubt about a name, never a name.
Letters: C channels, K parameters (those of effects in units of their scale, then the tolerances in deviations).

Source: Box (1980), Sampling and Bayes' inference in scientific modelling and robustness, J. R. Statist. Soc. A 143 (predictive
densities of data that were not used).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.evidence.fitting import Fitted
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.parameters import is_number
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.judge.predictive import PASSES
from aerial_gym.sim2real.predict.predictor import Predictor


def with_doubt(selection: SelectionResult, test: Predictor) -> SelectionResult:
    """Return a selection that knows how much more probable the test flights make the rivals of its names."""
    rivals = {one.fitted.label: one.fitted for name in selection.accepted for one in selection.rivals_of(name)}
    if not rivals:
        return selection
    densities = log_densities(test, [selection.chosen.named, *rivals.values()], selection)
    gain = (densities[1:] - densities[0]) / selection.chosen.best.overdispersion
    return replace(selection, doubt=dict(zip(rivals, np.maximum(gain, 0.0).tolist(), strict=True)))


def doubt_notes(selection: SelectionResult) -> list[Finding]:
    """Return a note on each tie that only the test flights make."""
    return [
        Finding("doubt_by_test", name, {"other": rival.effect, "log_odds": rival.log_odds - rival.doubt})
        for name in selection.accepted
        for rival in selection.ties_of(name)
        if rival.told_apart_by_training
    ]


@dataclass(frozen=True, kw_only=True)
class Left:
    """What a set leaves of the test flights, in sums over their rows, and how well training knows its parameters."""

    square: Array
    """Of r, (C,)."""

    gradient: Array
    """``J r``, (C, K)."""

    product: Array
    """``J J``, (C, K, K)."""

    precision: Array
    """A, (K, K)."""

    def best(self, weight: Array) -> Array:
        """Return the parameters that all flights ask for, (K,)."""
        joint = self.precision + np.tensordot(weight, self.product, axes=1)
        return np.linalg.solve(joint, weight @ self.gradient)

    def squares_at(self, step: Array) -> Array:
        """Return the sum of squares of each channel at some parameters, (C,)."""
        return self.square - 2.0 * self.gradient @ step + np.einsum("k,ckl,l->c", step, self.product, step)

    def log_density(self, weight: Array) -> float:
        """Return the log density of the test flights."""
        step, seen = self.best(weight), np.tensordot(weight, self.product, axes=1)
        surer = np.linalg.slogdet(self.precision + seen)[1] - np.linalg.slogdet(self.precision)[1]
        return -0.5 * float(weight @ self.square - (weight @ self.gradient) @ step + surer)


def log_densities(test: Predictor, fits: Sequence[Fitted], selection: SelectionResult) -> Array:
    """Return the log density of the test flights under each set, but for a constant that all have, (M,).

    A channel weighs no more than what the best of all sets leaves of it allows.
    """
    weights, sums = selection.weights, [left_of(test, one, selection) for one in fits]
    rows, weight = sum(time.size for time in test.times), weights.weight
    for _ in range(PASSES):
        least = np.min([one.squares_at(one.best(weight)) for one in sums], axis=0) / rows
        weight = weights.where_left(least)
    return np.array([one.log_density(weight) for one in sums])


def left_of(test: Predictor, fitted: Fitted, selection: SelectionResult) -> Left:
    """Return what a set leaves of the test flights, about its most probable model with offsets of flights taken out."""
    at, offsets = fitted.within, selection.own_offsets
    predicted = test.predict(at)
    tolerance = tolerance_jacobian(test, at)
    columns = effect_jacobian(test, at, fitted.effects, predicted, beside=tolerance)
    owners = [(name, place) for name in fitted.effects for place in range(len(EFFECTS.get(name).parameters))]
    own = [k for k, owner in enumerate(owners) if is_number(*owner)]
    kept = np.array([*own, *range(len(owners), len(owners) + test.num_tolerances)])
    jacobian = np.concatenate(offsets.taken_out([part[:, :, kept] for part in columns]))
    left = np.concatenate(offsets.taken_out([m - p for m, p in zip(test.measured, predicted, strict=True)]))
    count = kept.size
    return Left(
        square=np.square(left).sum(axis=0),
        gradient=np.einsum("rck,rc->ck", jacobian, left),
        product=np.stack([jacobian[:, c].T @ jacobian[:, c] for c in range(left.shape[1])]),
        precision=np.linalg.inv(fitted.parameters.covariance[:count, :count]),
    )
