"""Gauss-Newton least squares through the simulator, jointly for effects and tolerances, from sums over time blocks.

The residual is linearised by finite differences of whole predictions; all further results follow from the block sums.
Letters: B blocks, C channels, K parameters (of effects in units of scale, then N tolerances in standard deviations).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.least_squares.box_minimum import minimise_in_bounds
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    DerivativesWithWeights,
    NuisanceSums,
    sum_of_products,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    Derivatives,
    correct_derivatives,
    effect_jacobian,
    is_continuous_parameter,
    parameter_bounds,
    parameter_row,
    parameter_scales,
    replace_params,
)
from aerial_gym.sim2real.identify.least_squares.moments import (
    FlightOffsets,
    Moments,
    block_moments,
)
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

UNIT = np.ones(1)  # Weight for moments that already include the channel weights (``Beside.moments``)
Frozen = frozenset[tuple[str, int]]  # Fixed parameters: effect, and index among its parameters
WEAK_PRIOR = 100.0  # Prior standard deviation of effect parameters in units of scale, for fits without data
FARTHEST_DEVIATION = 5.0  # Largest deviation of a tolerance in standard deviations

MOST_STEPS = 8
SHARES = (1.0, 0.5, 0.25, 0.125)  # Step lengths, tried in order until the fit is no worse
ROUNDING = 1e-6  # Relative rise of the squares that counts as none

MOST_TO_PROMISE, MOST_TO_MENDED = 5.0, 25.0
"""Largest gain of a fit relative to the promise of its derivatives, if these are fresh, or updated (plus its past gain).
Of 250 fits of a slung load and of ARPL and IDSIA flights, none gained more than 1.5 and 11.5 times."""

NOTHING_LEFT = 0.05  # Least promised log likelihood of a step; smaller gains change no selection


@dataclass(frozen=True, kw_only=True)
class ModelFit:
    """A fitted model with its linearisation."""

    effects: tuple[str, ...]  # Names in the order of the parameters
    params: ModelParams  # Point of linearisation: the best fit, without deviations
    moments: Moments  # Sums at that point
    low: Array  # Lowest possible step of each parameter, (K,)
    high: Array  # Highest possible step, (K,)
    num_effect_params: int  # Number of the K parameters that belong to effects; they come first
    frozen: Frozen = frozenset()  # Fixed parameters, which the flights do not determine

    @property
    def is_finite(self) -> bool:
        """Return whether prediction and derivatives are finite; for a pendulum over the top they are not."""
        moments = self.moments
        return all(bool(np.isfinite(sums).all()) for sums in (moments.square, moments.gradient, moments.product))

    @property
    def parameter_owners(self) -> list[tuple[str, int]]:
        """Return the effect and index of each effect parameter."""
        return [(name, place) for name in self.effects for place in range(len(EFFECTS.get(name).parameters))]

    @property
    def indices_of_fitted_effect_params(self) -> Indices:
        """Return the indices of the fitted effect parameters."""
        owners = enumerate(self.parameter_owners)
        return np.array(
            [k for k, owner in owners if owner not in self.frozen and is_continuous_parameter(*owner)], dtype=int
        )

    @property
    def indices_of_fitted_params(self) -> Indices:
        """Return the indices of the fitted effect parameters and the tolerances."""
        return np.concatenate((self.indices_of_fitted_effect_params, np.arange(self.num_effect_params, self.low.size)))

    def indices_of_effect(self, effect: str) -> Indices:
        """Return the indices of an effect's parameters."""
        return np.array([k for k, (name, _) in enumerate(self.parameter_owners) if name == effect], dtype=int)


@dataclass(frozen=True, kw_only=True)
class StopRule:
    """Stopping rule of a fit; by default it converges."""

    worth: Callable[[ModelFit], float] = lambda _: np.inf  # Value of a fit, or of its best subset, if linear
    least: float = -np.inf  # Value that the fit must be able to reach; otherwise it stops at once
    enough: float = NOTHING_LEFT  # Log likelihood that fresh derivatives may promise at the end

    def is_out_of_reach(self, fit: ModelFit, more: float) -> bool:
        """Return whether a fit cannot reach ``least`` even with ``more`` log likelihood than its derivatives promise."""
        return np.isfinite(more) and np.isfinite(self.least) and self.worth(fit) + more < self.least


CONVERGENCE = StopRule()


def prior_precision(fit: ModelFit) -> Array:
    """Return the inverse prior variance of each parameter, (K,): 1 for tolerances, nearly 0 for effects."""
    precision = np.ones(fit.low.size)
    precision[: fit.num_effect_params] = WEAK_PRIOR**-2
    return precision


def normal_equations_without_prior(fit: ModelFit, weight: Array, blocks: Indices | None = None) -> tuple[Array, Array]:
    """Return ``sum w J J^T`` (K, K) and ``sum w J r`` (K,) over some blocks."""
    chosen = slice(None) if blocks is None else blocks
    product = np.einsum("c,bckl->kl", weight, fit.moments.product[chosen])
    return product, np.einsum("c,bck->k", weight, fit.moments.gradient[chosen])


def least_squares_step_in_bounds(fit: ModelFit, weight: Array, free: Indices, blocks: Indices | None = None) -> Array:
    """Return the step (K,) that minimises the weighted squares plus the prior, within the bounds; 0 where not free."""
    (product, gradient), step = normal_equations_without_prior(fit, weight, blocks), np.zeros(fit.low.size)
    if free.size:
        a = product[np.ix_(free, free)] + np.diag(prior_precision(fit)[free])
        step[free] = minimise_in_bounds(a, gradient[free], fit.low[free], fit.high[free])
    return step


def left_out_mean_square(fit: ModelFit, weight: Array, flights: Indices) -> Array:
    """Return the mean square of each channel's residual with every flight predicted by a fit of the others, (C,).

    ``flights``: number of the flight of each log (``flight_numbers``).
    """
    moments, free = fit.moments, fit.indices_of_fitted_params
    squares = np.zeros_like(moments.square)
    for flight in np.unique(flights):
        own = flights[moments.flight] == flight
        used = np.flatnonzero(own if own.all() else ~own)  # a single flight cannot be left out
        step = least_squares_step_in_bounds(fit, weight, free, used)
        squares[own] = moments.block_squares(np.tile(step, (own.size, 1)))[own]
    return squares.sum(axis=0) / moments.count.sum()


def linearise_at_params(
    predictor: Predictor, effects: tuple[str, ...], params: ModelParams, tolerance: Derivatives, *,
    offsets: FlightOffsets | None = None,
) -> ModelFit:  # fmt: skip
    """Return the linearised fit at a point, by derivatives (rows, C, N) of tolerances, without flight ``offsets``."""
    predicted = predictor.predict(params)
    own = effect_jacobian(predictor, params, effects, predicted)
    residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
    jacobians = (np.concatenate(parts, axis=2) for parts in zip(own, tolerance, strict=True))
    if offsets is not None:
        residuals, jacobians = offsets.remove_offsets(residuals), offsets.remove_offsets(jacobians)
    return fit_of_moments(predictor.robot, effects, params, block_moments(predictor.times, residuals, jacobians))


def fit_of_moments(
    robot: RobotCfg, effects: tuple[str, ...], params: ModelParams, moments: Moments, frozen: Frozen = frozenset()
) -> ModelFit:
    """Return the linearised fit at a point from its moments, with effect parameters first."""
    here, scale = parameter_row(params, effects), parameter_scales(effects)
    lowest, highest = parameter_bounds(robot, effects)
    farthest = np.full(moments.gradient.shape[2] - here.size, FARTHEST_DEVIATION)
    low, high = ((bound - here) / scale for bound in (lowest, highest))
    return ModelFit(
        effects=effects,
        params=params,
        moments=moments,
        low=np.concatenate((low, -farthest)),
        high=np.concatenate((high, farthest)),
        num_effect_params=here.size,
        frozen=frozen,
    )


def fit_effects(
    predictor: Predictor, effects: tuple[str, ...], start: ModelParams, beside: NuisanceSums, *,
    frozen: Frozen = frozenset(), derivatives: Derivatives | None = None, fresh: bool = False,
    rule: StopRule = CONVERGENCE,
) -> tuple[ModelFit, list[Array], float]:  # fmt: skip
    """Return a Gauss-Newton fit of effects, its derivatives, and the log likelihood that it may have missed beyond these.

    Steps that overshoot are halved. Nuisance columns ``beside``, with the channel weights (``UNIT``), are fitted jointly.
    Broyden's update corrects the derivatives, so a step costs one prediction. If these promise no gain or give none, they
    are computed anew, and the fit ends if that does not help, or if its steps gained what they promised, to within
    ``rule.enough``. ``derivatives`` by the parameters, per scale, near the start, (rows, C, P); ``fresh``: at the start.
    Source: Broyden (1965), A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19.
    """
    params, predicted = start, predictor.predict(start)
    residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
    if derivatives is None:
        own, fresh = effect_jacobian(predictor, start, effects, predicted), True
    else:
        own = [part.astype(np.float64) for part in derivatives]
    first, steps = (cost := least_cost_over_nuisances(beside, residuals)), 0
    off = np.inf  # error of the gain promised by the last computed derivatives, over the steps since
    while True:
        fit = fit_of_moments(predictor.robot, effects, params, beside.moments_with_effects(residuals, own), frozen)
        if not np.isfinite(cost):
            return fit, own, np.inf
        whole, moved = least_squares_step_in_bounds(fit, UNIT, fit.indices_of_fitted_params), None
        promised = 0.5 * cost - _linear_cost(fit, whole)
        more = _possible_gain(promised, 0.5 * (first - cost), fresh=fresh)
        if (fresh or steps > 1) and rule.is_out_of_reach(fit, more):
            return fit, own, more
        if promised >= (rule.enough if fresh else NOTHING_LEFT) and steps < MOST_STEPS:
            step, here = whole[: fit.num_effect_params], parameter_row(params, effects)
            for share in SHARES:
                gone = share * step
                there = replace_params(predictor.robot, params, effects, here + parameter_scales(effects) * gone)
                moved = [m - p for m, p in zip(predictor.measured, predictor.predict(there), strict=True)]
                if (new_cost := least_cost_over_nuisances(beside, moved)) <= cost * (1.0 + ROUNDING):
                    wrong = abs(promised - 0.5 * (cost - new_cost)) if share == 1.0 else np.inf
                    off = wrong if fresh or steps == 0 else off + wrong
                    correct_derivatives(own, gone, [r - m for r, m in zip(residuals, moved, strict=True)])
                    params, residuals, cost, steps, fresh = there, moved, new_cost, steps + 1, False
                    break
            else:
                moved = None
        if moved is None:
            if fresh:
                return fit, own, more
            if off <= rule.enough and promised < NOTHING_LEFT:
                return fit, own, (MOST_TO_PROMISE - 1.0) * (promised + off)
            del own  # large, so free it before the next one
            own, fresh = effect_jacobian(predictor, params, effects, predictor.predict(params)), True


def _possible_gain(promised: float, gained: float, *, fresh: bool) -> float:
    """Return the possible further log likelihood of a fit, from the promise of its derivatives and its past gain."""
    more = (MOST_TO_PROMISE - 1.0) * promised if fresh else (MOST_TO_MENDED - 1.0) * promised + gained
    return more if np.isfinite(more) else np.inf


def _linear_cost(fit: ModelFit, step: Array) -> float:
    """Return the negative log likelihood and tolerance prior after a step (K,) in the linear model."""
    product, gradient = normal_equations_without_prior(fit, UNIT)
    prior = float(np.square(step[fit.num_effect_params :]).sum())
    square = float(fit.moments.square.sum()) - 2.0 * float(gradient @ step) + float(step @ product @ step)
    return 0.5 * (square + prior)


def least_cost_over_nuisances(beside: NuisanceSums, residuals: Sequence[Array]) -> float:
    """Return the weighted squares plus prior, minimised over the nuisance columns; infinite for non-finite residuals."""
    if not all(np.isfinite(part).all() for part in residuals):
        return np.inf
    one = DerivativesWithWeights([[part[:, :, None]] for part in residuals], beside.offsets)
    square, gradient = float(sum_of_products(one, one)[0, 0]), sum_of_products(one, beside.columns)[0]
    product, far = beside.whole + np.eye(beside.width), np.full(beside.width, FARTHEST_DEVIATION)
    step = minimise_in_bounds(product, gradient, -far, far) if far.size else gradient
    return square - 2.0 * float(gradient @ step) + float(step @ product @ step)
