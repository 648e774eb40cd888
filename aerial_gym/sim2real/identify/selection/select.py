"""Selection of effects: those of the most probable set, fitted with their uncertainty, and their rivals."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import neutral_params
from aerial_gym.sim2real.identify.candidates.nuisance import flight_offsets
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Label
from aerial_gym.sim2real.identify.least_squares.covariance import is_identifiable, uncertainty
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Frozen, ModelFit, fit_effects, linearise_at_params
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets, Weighting
from aerial_gym.sim2real.identify.selection.choose import MostProbableSet, choose_effects
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE, Criteria, CrossValidation, FitScore
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress, silent


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Another effect in place of a named one."""

    effect: str
    fitted: EffectSetFit  # The most probable set with it and without the named one
    log_odds: float  # Log odds of that set relative to the most probable one, divided by overdispersion, plus ``doubt``
    wider: bool  # Whether the named effect is a special case of it
    doubt: float = 0.0  # Log odds that the test flights add in its favour, at least 0

    @property
    def is_distinct(self) -> bool:
        """Whether the named effect is clearly more probable."""
        return self.log_odds < -LEAST_SCORE

    @property
    def is_distinct_in_training(self) -> bool:
        """Whether the named effect is clearly more probable by the training flights alone."""
        return self.log_odds - self.doubt < -LEAST_SCORE


def default_effects() -> tuple[str, ...]:
    """Return the effects that the selection considers by default."""
    return tuple(name for name in EFFECTS if EFFECTS.get(name).by_default)


@dataclass(frozen=True, kw_only=True)
class SelectionResult:
    """The named effects with their fit, the sets that were compared, and the effects that cannot be tested."""

    declared: FitScore
    final: FitScore
    chosen: MostProbableSet  # The sets that were compared
    not_testable: dict[str, Finding]  # Effects that these flights cannot show, with the reason
    left_out: CrossValidation
    criteria: Criteria
    looked_for: tuple[str, ...] = field(default_factory=default_effects)  # Effects that the selection was to consider
    doubt: dict[Label, float] = field(default_factory=dict)  # Log odds by test flights over the named set, at least 0

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Return the named effects."""
        return self.final.effects

    @property
    def weights(self) -> Weighting:
        """Return the weights of the channels."""
        return self.chosen.weights

    @property
    def own_offsets(self) -> FlightOffsets:
        """Return the channel offsets that differ between training flights."""
        return flight_offsets(self.chosen.best.structures, self.left_out.channels, self.weights.weight)

    @property
    def surrogates(self) -> dict[str, str]:
        """Return the surrogate effects, each with the structure that its size follows."""
        return self.chosen.surrogates

    def effect_rivals(self, name: str) -> list[Rival]:
        """Return the rivals of a named effect, the most probable first."""
        best, rival_fits = self.chosen.best, dict[str, Rival]()
        for fitted in self.chosen.sets_with_support:
            if name in fitted.effects:
                continue
            doubt = self.doubt.get(fitted.label, 0.0)
            odds = (fitted.log_posterior - best.log_posterior) / best.parameter_overdispersion + doubt
            for other in replacement_effects(name, best.effects, fitted.effects):
                if other not in rival_fits or odds > rival_fits[other].log_odds:
                    wider = name in EFFECTS.get(other).contains
                    rival_fits[other] = Rival(effect=other, fitted=fitted, log_odds=odds, wider=wider, doubt=doubt)
        return sorted(rival_fits.values(), key=lambda rival: -rival.log_odds)

    def effect_ties(self, name: str) -> list[Rival]:
        """Return the rivals that are not distinct from a named effect, without its generalisations."""
        return [rival for rival in self.effect_rivals(name) if not rival.is_distinct and not rival.wider]


def replacement_effects(name: str, best: Sequence[str], other: Sequence[str]) -> list[str]:
    """Return the effects of another set that replace a named one: relatives by ``contains``, else new unrelated effects."""
    lacking, new = [one for one in best if one not in other], [one for one in other if one not in best]
    cases = {
        one: [case for case in new if one in EFFECTS.get(case).contains or case in EFFECTS.get(one).contains]
        for one in lacking
    }
    return cases[name] or [one for one in new if not any(one in of for of in cases.values())]


def select_effects(
    predictor: Predictor,
    declared: ModelParams,
    criteria: Criteria,
    progress: Progress = silent,
    *,
    test: Sequence[Flight] = (),
    candidates: Sequence[str] | None = None,
) -> SelectionResult:
    """Return the most probable set of effects given the training flights, added to the declared model.

    ``test``: test flights, only to skip effects whose quantities their logs lack. ``candidates``: effects to consider;
    None: all with ``by_default``. Raise ``ConfigError`` for one that predicts no row of a rigid vehicle in air, or
    ``UnknownNameError``.
    """
    named = default_effects() if candidates is None else tuple(candidates)
    sought = [name for name in named if EFFECTS.get(name).is_selectable]
    if candidates is not None and len(sought) < len(named):
        wrong = next(name for name in named if name not in sought)
        if not EFFECTS.get(wrong).on_rigid:
            raise ConfigError(
                f"{wrong} acts on links where they are, but this comparison takes vehicles as rigid in their reference pose: a "
                "robot file with joints may hold it, but it cannot be asked for"
            )
        raise ConfigError(
            f"{wrong} is random and predicts no row: the residual is tested for it anyway; remove it from the candidates"
            if EFFECTS.get(wrong).random
            else f"{wrong} acts under water, but flights are in air: a robot file may hold it; remove it from the candidates"
        )
    reasons = {name: finding_on_untestable_effect(name, predictor.robot, predictor.flights, test) for name in sought}
    able = [name for name in sought if not reasons[name]]
    chosen = choose_effects(predictor, declared, able, material=criteria.material, progress=progress)
    give_back_memory()
    scorer = _Scorer(predictor, declared, criteria, chosen)
    final, chosen = scorer.score_without_undetermined()
    unseen = {name: Finding("not_excited", name) for name in chosen.hidden if name not in chosen.effects}
    return SelectionResult(
        declared=scorer.nothing,
        final=final,
        chosen=chosen,
        not_testable={name: reason for name, reason in reasons.items() if reason} | unseen,
        left_out=scorer.left_out,
        criteria=criteria,
        looked_for=named,
    )


class _Scorer:
    """Fits sets with their uncertainty, and predicts flights left out."""

    def __init__(
        self, predictor: Predictor, declared: ModelParams, criteria: Criteria, chosen: MostProbableSet
    ) -> None:
        self.predictor, self.declared, self.chosen, self.weights = predictor, declared, chosen, chosen.weights
        self.tolerance = tolerance_jacobian(predictor, chosen.named.model_with_deviations, np.float32)
        weight = self.weights.weight
        self.offsets = flight_offsets(chosen.best.structures, predictor.channels, weight)
        parts = [[part] for part in self.tolerance]
        self.beside = NuisanceSums(predictor.times, parts, weight, offsets=self.offsets)
        empty_fit = self._fit((), declared, frozenset())
        self.left_out = CrossValidation(
            count=empty_fit.moments.count,
            flight=empty_fit.moments.flight,
            weights=self.weights,
            criteria=criteria,
            channels=predictor.channels,
            tolerated=chosen.tolerated,
        )
        self.nothing = self._score(empty_fit)
        """The declared model."""

    def _fit(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen) -> ModelFit:
        rival_fits, _, _ = fit_effects(self.predictor, effects, start, self.beside, frozen=frozen)
        params = rival_fits.params
        by_channel = linearise_at_params(self.predictor, effects, params, self.tolerance, offsets=self.offsets)
        return replace(by_channel, frozen=frozen)

    def score(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen = frozenset()) -> FitScore:
        """Return the model with these effects fitted, and its squared residuals on flights left out."""
        return self._score(self._fit(effects, start, frozen))

    def _score(self, fit: ModelFit) -> FitScore:
        spread, left_out = uncertainty(fit, self.weights.weight), self.left_out.squares(fit)
        by_flight = replace(
            fit, moments=fit.moments.sum_by_label(fit.moments.flight)
        )  # these sums suffice from here on
        return FitScore(fit=by_flight, spread=spread, left_out=left_out)

    def score_without_undetermined(self) -> tuple[FitScore, MostProbableSet]:
        """Return the fit of the named effects, and the choice, both with undetermined parameters at neutral."""
        scored = self.score(self.chosen.effects, self.chosen.named.params)
        owners = {scored.fit.parameter_owners[k]: k for k in scored.fit.free_effect_params}
        uncertain = scored.fit.free_effect_params[~is_identifiable(scored.spread.plain)]  # by more than their scale
        unseen = {owner for owner, k in owners.items() if k in uncertain}
        if not unseen:
            return scored, self.chosen
        seen = owners.keys() - unseen
        blind = set(self.chosen.effects).difference(name for name, _ in seen)
        if blind:  # the complete fit determines none of their parameters
            name = min(blind)
            neutral = neutral_params(name, self.declared, self.predictor.robot)
            self.chosen = self.chosen.without_undetermined_effect(name, neutral)
            return self.score_without_undetermined()
        start = self.params_at_neutral(self.chosen.named.params, unseen)
        scored = self.score(self.chosen.effects, start, frozenset(unseen))
        sets = self.chosen.without.items()
        without = {name: replace(one, params=self.params_at_neutral(one.params, unseen)) for name, one in sets}
        return scored, replace(self.chosen, without=without)

    def params_at_neutral(self, params: ModelParams, places: Iterable[tuple[str, int]]) -> ModelParams:
        """Return model parameters with some, by effect and index, at their neutral values."""
        for name, place in places:
            if name in params.effects:
                values = params.effects[name].copy()
                values[place] = neutral_params(name, self.declared, self.predictor.robot)[place]
                params = params.with_effect(name, values)
        return params
