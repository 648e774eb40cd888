"""Least squares through the physics of the simulator: effects and tolerances jointly, from sums over blocks of time.

The residual of a model is linearised in its parameters by differences of whole predictions. Everything after that
(fits without a flight, scores, standard errors) needs only sums over blocks: squares, gradients and products.
Letters: B blocks, C channels, K parameters (those of effects in units of their scale, then N tolerances in deviations).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from aerial_gym.config.robot import RobotCfg
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array, Indices
from aerial_gym.sim2real.identify.least_squares.derivatives import Derivatives, effect_jacobian, exact_along
from aerial_gym.sim2real.identify.least_squares.moments import Moments, block_length, block_moments, of_flights
from aerial_gym.sim2real.identify.least_squares.own_offsets import OwnOffsets
from aerial_gym.sim2real.identify.least_squares.parameters import bounds_of, is_number, params_of, scales, with_params
from aerial_gym.sim2real.identify.least_squares.weighted import Beside, Weighted, product_of
from aerial_gym.sim2real.identify.least_squares.within_bounds import minimum_within
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

UNIT = np.ones(1)
"""Weight of the moments of a fit that have the weights of the channels in them (``Beside.moments``)."""

Frozen = frozenset[tuple[str, int]]
"""Parameters that stay as they are: effect, and place among its parameters."""

WEAK_PRIOR = 100.0
"""Standard deviation of the effects' parameters in units of their scale: keeps a fit solvable where data are silent."""

FARTHEST_DEVIATION = 5.0
"""No tolerance is taken to be off by more standard deviations than this."""

MOST_STEPS = 8
SHARES = (1.0, 0.5, 0.25, 0.125)
"""Of a step, tried until one fits no worse than before."""

ROUNDING = 1e-6
"""Relative rise of the squares that is none."""

MOST_TO_PROMISE, MOST_TO_MENDED = 5.0, 25.0
"""A fit gains less than so many times what its derivatives promise, taken where it is, or mended and as much as it has gained.

Of 250 fits of a slung load and of flights of ARPL and IDSIA none has gained more than 1.5 times, or 11 times and a half."""

NOTHING_LEFT = 0.05
"""A step is not taken that promises less log likelihood than this: it would change no choice."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A fitted model with its linearisation."""

    effects: tuple[str, ...]
    """Names, in the order of the parameters."""

    params: ModelParams
    """Where it is linearised: the best fit, with no deviation."""

    moments: Moments
    """At that point."""

    low: Array
    """Lowest possible step of each parameter, (K,)."""

    high: Array
    """Highest, (K,)."""

    num_effect_params: int
    """The first so many of the K parameters belong to effects."""

    frozen: Frozen = frozenset()
    """Parameters that the flights do not show; they stay where they are."""

    @property
    def finite(self) -> bool:
        """Return whether prediction and derivatives are finite: a pendulum that goes over the top is not."""
        moments = self.moments
        return all(bool(np.isfinite(sums).all()) for sums in (moments.square, moments.gradient, moments.product))

    @property
    def owners(self) -> list[tuple[str, int]]:
        """Return effect and place of each parameter of effects."""
        return [(name, place) for name in self.effects for place in range(len(EFFECTS.get(name).parameters))]

    @property
    def free_effects(self) -> Indices:
        """Return the parameters of effects that are fitted."""
        return np.array(
            [k for k, owner in enumerate(self.owners) if owner not in self.frozen and is_number(*owner)], dtype=int
        )

    @property
    def free_all(self) -> Indices:
        """Return these and the tolerances."""
        return np.concatenate((self.free_effects, np.arange(self.num_effect_params, self.low.size)))

    def columns_of(self, effect: str) -> Indices:
        """Return the places of an effect's parameters."""
        return np.array([k for k, (name, _) in enumerate(self.owners) if name == effect], dtype=int)


@dataclass(frozen=True, kw_only=True)
class Goal:
    """How far a fit is worth going."""

    worth: Callable[[Fit], float] = lambda _: np.inf
    """What a fit would be worth, or the best with fewer effects, if the model about it were linear."""

    least: float = -np.inf
    """What a fit must be able to be worth; else it ends wherever it is."""

    enough: float = NOTHING_LEFT
    """Log likelihood that derivatives taken where it ends may still promise; what it is worth has that in it."""

    def missed(self, fit: Fit, more: float) -> bool:
        """Return whether a fit cannot come there, with ``more`` log likelihood than its derivatives promise."""
        return np.isfinite(more) and np.isfinite(self.least) and self.worth(fit) + more < self.least


def prior_precision(fit: Fit) -> Array:
    """Return the inverse prior variance of each parameter, (K,): one for tolerances, almost none for effects."""
    precision = np.ones(fit.low.size)
    precision[: fit.num_effect_params] = WEAK_PRIOR**-2
    return precision


def normal_equations(fit: Fit, weight: Array, blocks: Indices | None = None) -> tuple[Array, Array]:
    """Return ``sum w J J^T`` (K, K) and ``sum w J r`` (K,) over some blocks."""
    chosen = slice(None) if blocks is None else blocks
    product = np.einsum("c,bckl->kl", weight, fit.moments.product[chosen])
    return product, np.einsum("c,bck->k", weight, fit.moments.gradient[chosen])


def best_step(fit: Fit, weight: Array, free: Indices, blocks: Indices | None = None) -> Array:
    """Return the step (K,) that minimises the weighted squares plus the prior, within the bounds; 0 where not free."""
    return solve_within(fit, *normal_equations(fit, weight, blocks), free)


def solve_within(fit: Fit, product: Array, gradient: Array, free: Indices) -> Array:
    """Return the step (K,) that normal equations and the prior ask for, within the bounds; 0 where not free."""
    step = np.zeros(fit.low.size)
    if free.size:
        a = product[np.ix_(free, free)] + np.diag(prior_precision(fit)[free])
        step[free] = minimum_within(a, gradient[free], fit.low[free], fit.high[free])
    return step


def linearise(
    predictor: Predictor,
    effects: tuple[str, ...],
    params: ModelParams,
    tolerance: Derivatives,
    *,
    offsets: OwnOffsets | None = None,
) -> Fit:
    """Return the model at a point, with the derivatives by the tolerances, (rows, C, N) of each flight.

    ``offsets`` of flights are taken out of all. Flight by flight: derivatives of all flights need not be held a second time.
    """
    predicted = predictor.predict(params)
    own, length = effect_jacobian(predictor, params, effects, predicted), block_length(predictor.times)
    found = []
    for time, m, p, *parts in zip(predictor.times, predictor.measured, predicted, own, tolerance, strict=True):
        residuals, jacobians = [m - p], [np.concatenate(parts, axis=2)]
        if offsets is not None:
            residuals, jacobians = offsets.taken_out(residuals), offsets.taken_out(jacobians)
        found.append(block_moments([time], residuals, jacobians, length=length))
    return fit_of_moments(predictor.robot, effects, params, of_flights(found))


def fit_at(
    predictor: Predictor,
    effects: tuple[str, ...],
    params: ModelParams,
    residuals: list[Array],
    jacobians: Sequence[Array],
) -> Fit:
    """Return the model at a point from its residuals there and their derivatives (rows, C, K)."""
    moments = block_moments(predictor.times, residuals, jacobians)
    return fit_of_moments(predictor.robot, effects, params, moments)


def fit_of_moments(
    robot: RobotCfg,
    effects: tuple[str, ...],
    params: ModelParams,
    moments: Moments,
    frozen: Frozen = frozenset(),
) -> Fit:
    """Return the model at a point from the moments there, tolerances and structures behind the parameters of effects."""
    here, scale = params_of(params, effects), scales(effects)
    lowest, highest = bounds_of(robot, effects)
    farthest = np.full(moments.gradient.shape[2] - here.size, FARTHEST_DEVIATION)
    return Fit(
        effects=effects,
        params=params,
        moments=moments,
        low=np.concatenate(((lowest - here) / scale, -farthest)),
        high=np.concatenate(((highest - here) / scale, farthest)),
        num_effect_params=here.size,
        frozen=frozen,
    )


def fit_effects(
    predictor: Predictor,
    effects: tuple[str, ...],
    start: ModelParams,
    beside: Beside,
    *,
    frozen: Frozen = frozenset(),
    derivatives: Derivatives | None = None,
    fresh: bool = False,
    goal: Goal = Goal(),
) -> tuple[Fit, list[Array], float]:
    """Return the model with some effects fitted by Gauss-Newton steps, until nothing is left to gain, and its derivatives.

    And the log likelihood that it may have missed at most, beyond what these promise.

    A step that overshoots is halved. Tolerances and structures take their share while the effects are fitted; they are not part
    of the model. The moments of the fit have the weights of the channels in them (``UNIT``).
    A step costs one prediction in place of one for each parameter: derivatives are mended along it by what the prediction
    really did. Where they promise nothing more, or lead nowhere, they are taken anew; the fit ends if nothing comes of that. It
    ends without where its steps gave what derivatives had promised, as nearly as is enough: they hold here.

    Args:
        predictor: Training flights.
        effects: Effects whose parameters are free; all must be in ``start``.
        start: First guess.
        beside: What is fitted beside them, linear, and what a row of each channel counts.
        frozen: Parameters that stay as they are.
        derivatives: Of the prediction by the effects' parameters, per scale, somewhere near the start, (rows, C, P).
        fresh: Whether these were taken at the start itself.
        goal: How far it goes.

    Source:
        Broyden (1965), A class of methods for solving nonlinear simultaneous equations, Mathematics of Computation 19.
    """
    params, predicted = start, predictor.predict(start)
    residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
    if derivatives is None:
        own, fresh = effect_jacobian(predictor, start, effects, predicted), True
    else:
        own = [part.astype(np.float64) for part in derivatives]
    first, steps = (cost := misfit(beside, residuals)), 0
    off = np.inf  # log likelihood by which the last derivatives were wrong along the steps taken with them
    while True:
        fit = fit_of_moments(predictor.robot, effects, params, beside.moments(residuals, own), frozen)
        if not np.isfinite(cost):
            return fit, own, np.inf
        whole, moved = best_step(fit, UNIT, fit.free_all), None
        promised = 0.5 * cost - _left_after(fit, whole)
        more = _more(promised, 0.5 * (first - cost), fresh=fresh)
        if (fresh or steps > 1) and goal.missed(fit, more):
            return fit, own, more
        if promised >= (goal.enough if fresh else NOTHING_LEFT) and steps < MOST_STEPS:
            step, here = whole[: fit.num_effect_params], params_of(params, effects)
            for share in SHARES:
                gone = share * step
                there = with_params(predictor.robot, params, effects, here + scales(effects) * gone)
                moved = [m - p for m, p in zip(predictor.measured, predictor.predict(there), strict=True)]
                if (new_cost := misfit(beside, moved)) <= cost * (1.0 + ROUNDING):
                    wrong = abs(promised - 0.5 * (cost - new_cost)) if share == 1.0 else np.inf
                    off = wrong if fresh or steps == 0 else off + wrong
                    exact_along(own, gone, [r - m for r, m in zip(residuals, moved, strict=True)])
                    params, residuals, cost, steps, fresh = there, moved, new_cost, steps + 1, False
                    break
            else:
                moved = None
        if moved is None:
            if fresh:
                return fit, own, more
            if off <= goal.enough and promised < NOTHING_LEFT:
                return fit, own, (MOST_TO_PROMISE - 1.0) * (promised + off)
            own, fresh = effect_jacobian(predictor, params, effects, predictor.predict(params)), True


def _more(promised: float, gained: float, *, fresh: bool) -> float:
    """Return the log likelihood that a fit may gain beyond what its derivatives promise, of that and what it has gained."""
    more = (MOST_TO_PROMISE - 1.0) * promised if fresh else (MOST_TO_MENDED - 1.0) * promised + gained
    return more if np.isfinite(more) else np.inf


def _left_after(fit: Fit, step: Array) -> float:
    """Return the negative log likelihood and prior of tolerances that a step (K,) would leave if the model were linear."""
    product, gradient = normal_equations(fit, UNIT)
    prior = float(np.square(step[fit.num_effect_params :]).sum())
    square = float(fit.moments.square.sum()) - 2.0 * float(gradient @ step) + float(step @ product @ step)
    return 0.5 * (square + prior)


def misfit(beside: Beside, residuals: Sequence[Array]) -> float:
    """Return the weighted squares plus the prior, with what is beside as it fits best; infinite if a residual is not finite."""
    if not all(np.isfinite(part).all() for part in residuals):
        return np.inf
    one = Weighted([[part[:, :, None]] for part in residuals], beside.offsets)
    square, gradient = float(product_of(one, one)[0, 0]), product_of(one, beside.columns)[0]
    product, far = beside.whole + np.eye(beside.width), np.full(beside.width, FARTHEST_DEVIATION)
    step = minimum_within(product, gradient, -far, far) if far.size else gradient
    return square - 2.0 * float(gradient @ step) + float(step @ product @ step)
