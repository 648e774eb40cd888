"""Fitted sets of effects, and selections made of them, without flights: evidence as a test wants it."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.candidates.nuisance import NuisanceColumns
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.evidence.guard import Support
from aerial_gym.sim2real.identify.evidence.laplace import Posterior
from aerial_gym.sim2real.identify.learned import CrossValidation
from aerial_gym.sim2real.identify.least_squares.covariance import Uncertainty
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Frozen, ModelFit
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets, Moments, Weighting
from aerial_gym.sim2real.identify.selection.choose import MostProbableSet
from aerial_gym.sim2real.identify.selection.criteria import Criteria
from aerial_gym.sim2real.identify.selection.select import SelectionResult
from aerial_gym.sim2real.predict.model_params import ModelParams
from tests.unit.sim2real.flat_flights import ROBOT, PredictorStub

PLACE = NuisanceColumns(kind="position", channel="specific_force.x", columns=[], size=1.0)


def make_fit(
    *effects: str, log: float = 0.0, fits: float | None = None, structures: tuple[NuisanceColumns, ...] = (),
    overdispersion: float = 1.0, odds: Mapping[str, float] | None = None,
    params: Mapping[str, Sequence[float]] | None = None,
) -> EffectSetFit:  # fmt: skip
    """Return a fitted set of a log posterior, at neutral but for ``params``; each effect holds by 10, or by its
    ``odds``. ``fits`` is its log likelihood; the log posterior if None."""
    values = {name: np.array((params or {}).get(name, EFFECTS.get(name).neutral(ROBOT)), float) for name in effects}
    size = sum(own.size for own in values.values())
    return EffectSetFit(
        effects=effects,
        structures=structures,
        params=ModelParams(effects=values),
        log_posterior=log,
        parameters=Posterior(
            columns=np.arange(size), step=np.zeros(size), covariance=np.eye(size), log_evidence=log,
            log_likelihood=log if fits is None else fits,
        ),
        support={
            name: Support(log_odds=(odds or {}).get(name, 10.0), wald=0.0, overdispersion=overdispersion, size=1)
            for name in effects
        },
    )  # fmt: skip


class FitStub(Fitter):
    """Fits that are given, by their effects, and by whether there is a structure beside them; others do not hold."""

    def __init__(self, *sets: EffectSetFit) -> None:
        self.sets = {(one.effects, bool(one.structures)): one for one in sets}
        self.predictor, self.declared, self._derivatives, self._beside = PredictorStub(), ModelParams(), {}, {}

    def fit(self, effects: Sequence[str], structures: Sequence[NuisanceColumns], start: ModelParams, *_, **_compared):
        assert set(start.effects) == set(effects)
        empty = make_fit(*effects, log=-1e3, odds=dict.fromkeys(effects, -1.0))
        return self.sets.get((tuple(effects), bool(structures)), empty)


def make_choice(
    best: EffectSetFit, *rest: EffectSetFit, named: EffectSetFit | None = None, **result: Any
) -> MostProbableSet:
    """Return the choice of one set among others, in which nothing else was found."""
    none: dict[str, Any] = {"without": {}, "adds": {}, "hidden": (), "surrogates": {}, "immaterial": {}, "refused": {}}
    return MostProbableSet(
        named=named or best, best=best, fits=tuple(sorted((best, *rest), key=lambda one: -one.log_posterior)),
        weights=Weighting(variance=np.ones(1), effective=np.ones(1)), tolerated=np.zeros(1), **none | result,
    )  # fmt: skip


def make_spread(columns: np.ndarray, plain: np.ndarray, tolerance: np.ndarray, blocks: Any = None) -> Uncertainty:
    """Return the uncertainty of parameters by 50 blocks of two flights, whose scatter is the plain covariance by default."""
    own = {"columns": columns, "step": np.zeros(len(columns)), "plain": plain, "tolerance": tolerance, "flights": None}
    scatter = plain if blocks is None else np.array(blocks)
    return Uncertainty(**own, blocks=scatter, num_blocks=50, num_flights=2)


def make_left_out(
    weights: Weighting, count: Any = (1.0,), flight: Any = (0,), channels=(), tolerated=0.0
) -> CrossValidation:
    size, blocks = len(weights.variance), len(count)
    rows = {
        "quarter": np.arange(blocks) * min(4, blocks) // blocks,
        "count": np.array(count),
        "flight": np.array(flight),
        "tolerated": np.full(size, tolerated),
    }
    return CrossValidation(**rows, weights=weights, criteria=Criteria(), channels=channels)


def make_final_fit(
    params: ModelParams, effects: tuple[str, ...] = (), *, variance: Sequence[float] = (), frozen: Frozen = frozenset()
) -> tuple[ModelFit, Uncertainty]:
    """Return a fit whose parameters of ``effects`` have these variances in units of scale, one by default."""
    size = sum(params.effects[name].size for name in effects)
    moments = Moments(
        count=np.ones(1), square=np.ones((1, 1)), gradient=np.zeros((1, 1, size)), product=np.eye(size)[None, None],
        flight=np.zeros(1, dtype=np.int64),
    )  # fmt: skip
    limit = np.full(size, np.inf)
    fit = ModelFit(
        effects=effects, params=params, moments=moments, low=-limit, high=limit, num_effect_params=size, frozen=frozen
    )
    columns = fit.indices_of_fitted_effect_params
    covariance = (np.diag(variance) if len(variance) else np.eye(size))[np.ix_(columns, columns)]
    return fit, make_spread(columns, covariance, np.zeros_like(covariance))


def make_selection(chosen: MostProbableSet | None = None, **more: Any) -> SelectionResult:
    """Return the selection with a choice; by default no effect is named."""
    chosen = chosen or make_choice(make_fit())
    fit, spread = make_final_fit(chosen.named.params, chosen.effect_names)
    offsets = FlightOffsets(size=np.zeros(1), weight=chosen.weights.weight, most=np.zeros(1))
    defaults = {"fit": fit, "spread": spread, "not_testable": {}, "criteria": Criteria(), "flight_offsets": offsets}
    return SelectionResult(**vars(chosen), **defaults | more)
