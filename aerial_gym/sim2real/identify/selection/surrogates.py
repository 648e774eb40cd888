"""Does an effect hold beside a structure that no effect has, or does it only stand in for a part of it?

Letters: B blocks, C channels, T rows.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit, is_number, params_of, prior_precision, scales
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, block_length, block_rows
from aerial_gym.sim2real.identify.selection.structure import Structure, squares_beside, structure_values
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.channels import Channel

Array = NDArray[np.float64]

KEPT = 0.5
"""Of its evidence, an effect must keep this share beside the structure."""

STEADY = 0.2
"""Its parameters may differ by this share of their distance from neutral between where the structure is low and high."""

CERTAIN = 25.0
"""Squared distance of parameters, in variances, above which a difference is none of chance: five standard deviations."""


class SurrogateTest:
    """A structure of the residual, and what effects are worth beside it."""

    def __init__(
        self,
        structure: Structure,
        flights: Sequence[Flight],
        times: Sequence[Array],
        channels: Sequence[Channel],
        weights: Weighting,
        residuals: list[Array],
    ) -> None:
        """Take the residuals with the effects, (T, C) each, and the structure that they have."""
        self._structure, self._flights, self._times, self._channels = structure, flights, times, channels
        self._weights, self._residuals = weights, residuals
        self._left = squares_beside(structure, flights, times, residuals, channels)

    def is_surrogate(self, name: str, fit: Fit, neutral: Array, less: list[Array]) -> bool:
        """Return whether an effect of a fitted model is not needed beside the structure, or changes with it.

        Never an effect that by its nature follows what the structure follows: its law may be off, but its name is right. Nor
        one that gains more beside the structure than alone: of what stands in for it, the structure takes a part.

        Args:
            name: The effect.
            fit: The model.
            neutral: Parameters with which the effect changes nothing, (P,).
            less: Residuals without the effect, the others fitted again, (T, C) each.
        """
        if self._structure.kind in EFFECTS.get(name).follows:
            return False
        alone, beside = self._evidence(less)
        return beside < KEPT * alone or (beside <= alone and self._changes(name, fit, neutral))

    def _evidence(self, less: list[Array]) -> tuple[float, float]:
        """Return the log likelihood that the effect gains without the structure and beside it."""
        squares = [np.sum([np.sum(part**2, axis=0) for part in parts], axis=0) for parts in (less, self._residuals)]
        alone = np.log(squares[0] / np.maximum(squares[1], 1e-300))
        left = squares_beside(self._structure, self._flights, self._times, less, self._channels)
        beside = np.log(left / np.maximum(self._left, 1e-300))
        return float(self._weights.effective @ alone), float(self._weights.effective @ beside)

    def _changes(self, name: str, fit: Fit, neutral: Array) -> bool:
        """Return whether the effect's parameters differ between blocks where the structure is low and where it is high."""
        own = np.array([k for k in fit.columns_of(name) if k in fit.free_effects and is_number(*fit.owners[k])])
        if self._structure.kind == "periodic" or own.size == 0:
            return False
        flights = self._flights, self._times, self._residuals, self._channels
        values = structure_values(self._structure, *flights)
        length = block_length(self._times)
        parts = [(v, block_rows(time, length)) for time, v in zip(self._times, values, strict=True)]
        height = np.array([v[rows].mean() for v, blocks in parts for rows in blocks])
        high = height > np.median(height)
        found, information = [], []
        for part in (high, ~high):
            product = np.einsum("c,bckl->kl", self._weights.weight, fit.moments.product[part])[np.ix_(own, own)]
            product = product + np.diag(prior_precision(fit)[own])
            gradient = np.einsum("c,bck->k", self._weights.weight, fit.moments.gradient[part])[own]
            found.append(np.linalg.solve(product, gradient))
            information.append(product)
        apart = found[0] - found[1]
        first = int(fit.columns_of(name)[0])
        far = ((params_of(fit.point, (name,)) - neutral) / scales((name,)))[own - first]
        weight = np.linalg.inv(np.linalg.inv(information[0]) + np.linalg.inv(information[1]))
        difference = float(apart @ weight @ apart)
        return difference > CERTAIN and difference > STEADY**2 * float(far @ weight @ far)
