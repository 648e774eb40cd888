"""Selection of effects: those of the most probable set, fitted with their uncertainty, and their rivals."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import law_relatives, neutral_params
from aerial_gym.sim2real.identify.candidates.nuisance import prior_of_flight_offsets
from aerial_gym.sim2real.identify.candidates.testable import finding_on_untestable_effect
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Label
from aerial_gym.sim2real.identify.least_squares.covariance import Uncertainty, is_identifiable, uncertainty
from aerial_gym.sim2real.identify.least_squares.derivative_sums import NuisanceSums
from aerial_gym.sim2real.identify.least_squares.derivatives import parameter_scales, tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Frozen, ModelFit, fit_effects, linearise_at_params
from aerial_gym.sim2real.identify.least_squares.moments import FlightOffsets
from aerial_gym.sim2real.identify.selection.candidate_view import occam_window
from aerial_gym.sim2real.identify.selection.choose import MostProbableSet, choose_effects
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE, Criteria
from aerial_gym.sim2real.identify.selection.rotor_search import variance_between_sets
from aerial_gym.sim2real.identify.selection.value_ties import ValueTie, find_value_ties
from aerial_gym.sim2real.logs.flights import Flight
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
    def is_clearly_less_probable(self) -> bool:
        """Whether the named effect is clearly more probable."""
        return self.log_odds < -LEAST_SCORE

    @property
    def is_clearly_less_probable_in_training(self) -> bool:
        """Whether the named effect is clearly more probable by the training flights alone."""
        return self.log_odds - self.doubt < -LEAST_SCORE


def default_effects() -> tuple[str, ...]:
    """Return the effects that the selection considers by default."""
    return tuple(name for name in EFFECTS if EFFECTS.get(name).by_default)


@dataclass(frozen=True, kw_only=True)
class SelectionResult(MostProbableSet):
    """The named effects with their fit, the sets that were compared, and the effects that cannot be tested."""

    fit: ModelFit  # Fit of the named effects, with sums by flight and channel
    spread: Uncertainty
    flight_offsets: FlightOffsets  # Channel offsets that differ between training flights
    not_testable: dict[str, Finding]  # Effects that these flights cannot show, with the reason
    criteria: Criteria
    looked_for: tuple[str, ...] = field(default_factory=default_effects)  # Effects that the selection was to consider
    value_ties: tuple[ValueTie, ...] = ()  # Effects on declared values that explain the flights as well
    doubt: dict[Label, float] = field(default_factory=dict)  # Log odds by test flights over the named set, at least 0

    def effect_rivals(self, name: str) -> list[Rival]:
        """Return the rivals of a named effect, the most probable first."""
        best, rival_fits = self.best, dict[str, Rival]()
        for fitted in self.sets_with_support:
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
        """Return the rivals that are not distinct from a named effect, without its generalisations and other laws."""
        rivals, cause = self.effect_rivals(name), EFFECTS.get(name).cause
        rest = (rival for rival in rivals if not rival.wider and EFFECTS.get(rival.effect).cause != cause)
        return [rival for rival in rest if not rival.is_clearly_less_probable]


def replacement_effects(name: str, best: Sequence[str], other: Sequence[str]) -> list[str]:
    """Return the effects of another set that replace a named one: related laws, else new unrelated effects."""
    lacking, new = [one for one in best if one not in other], [one for one in other if one not in best]
    cases = {one: [case for case in new if case in law_relatives(one)] for one in lacking}
    return cases[name] or [one for one in new if not any(one in of for of in cases.values())]


def select_effects(
    predictor: Predictor, declared: ModelParams, criteria: Criteria, progress: Progress = silent, *,
    test: Sequence[Flight] = (), candidates: Sequence[str] | None = None,
) -> SelectionResult:  # fmt: skip
    """Return the most probable set of effects given the training flights, added to the declared model.

    ``test``: test flights, only to skip effects whose quantities their logs lack. ``candidates``: effects to consider;
    None: all with ``by_default``. Raise ``ConfigError`` for one that predicts no row of a rigid vehicle in air, or
    ``UnknownNameError``.
    """
    named = default_effects() if candidates is None else tuple(candidates)
    sought = [name for name in named if EFFECTS.get(name).is_candidate_of_selection]
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
    predictor.clear_caches()
    final = FinalFit(predictor, declared, chosen)
    chosen, fit, spread = final.fit_determined()
    unseen = {name: Finding("not_excited", name) for name in chosen.hidden if name not in chosen.effect_names}
    return SelectionResult(
        **vars(chosen),
        fit=fit,
        spread=spread,
        flight_offsets=final.offsets,
        not_testable={name: why for name, why in reasons.items() if why and not EFFECTS.get(name).in_place} | unseen,
        criteria=criteria,
        looked_for=named,
        value_ties=final.find_ties(fit, able),
    )


def selection_without_effects(
    predictor: Predictor, declared: ModelParams, selection: SelectionResult, reasons: Mapping[str, Finding]
) -> SelectionResult:
    """Return a selection without some named effects, each with the reason against it, and the others fitted anew."""
    left = selection
    for name, reason in reasons.items():
        neutral = neutral_params(name, declared, predictor.robot)
        left = left.without_undetermined_effect(name, neutral, reason)
    final = FinalFit(predictor, declared, left)
    chosen, fit, spread = final.fit_determined()
    assert isinstance(chosen, SelectionResult)
    able = [name for name in selection.looked_for if EFFECTS.get(name).is_candidate_of_selection]
    ties = final.find_ties(fit, [name for name in able if name not in selection.not_testable])
    return replace(chosen, fit=fit, spread=spread, value_ties=ties)


class FinalFit:
    """Fit of the named effects with their uncertainty."""

    def __init__(self, predictor: Predictor, declared: ModelParams, chosen: MostProbableSet) -> None:
        self.predictor, self.declared, self.chosen, weight = predictor, declared, chosen, chosen.weights.weight
        self.tolerance = tolerance_jacobian(predictor, chosen.named.model_with_deviations, np.float32)
        self.offsets = prior_of_flight_offsets(chosen.best.structures, predictor.channels, weight)
        self.beside = NuisanceSums(predictor.times, [[part] for part in self.tolerance], weight, offsets=self.offsets)

    def fit(
        self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen = frozenset()
    ) -> tuple[ModelFit, Uncertainty]:
        """Return a model with these effects fitted, and its uncertainty."""
        params = fit_effects(self.predictor, effects, start, self.beside, frozen=frozen)[0].params
        fit = linearise_at_params(self.predictor, effects, params, self.tolerance, offsets=self.offsets)
        fit = replace(fit, frozen=frozen)
        by_flight = replace(fit, moments=fit.moments.sum_by_label(fit.moments.flight))  # suffices from here on
        spread = uncertainty(fit, self.chosen.weights.weight)
        scale = parameter_scales(fit.effects)
        owners = [fit.parameter_owners[k] for k in spread.columns.tolist()]
        variances = [variance_between_sets(self.chosen.possible, *owner) for owner in owners]
        return by_flight, replace(spread, between_sets=np.array(variances) / scale[spread.columns] ** 2)

    def fit_determined(self) -> tuple[MostProbableSet, ModelFit, Uncertainty]:
        """Return the choice with undetermined parameters at neutral, the fit of its effects, and the uncertainty."""
        fit, spread = self.fit(self.chosen.effect_names, self.chosen.named.params)
        owners = {fit.parameter_owners[k]: k for k in fit.indices_of_fitted_effect_params}
        uncertain = fit.indices_of_fitted_effect_params[~is_identifiable(spread.plain)]  # by more than their scale
        unseen = {owner for owner, k in owners.items() if k in uncertain}
        blind = set(self.chosen.effect_names).difference(name for name, _ in owners.keys() - unseen)
        code = "parameters_unknown" if blind else "interval_holds_neutral"
        blind = blind or self.effects_near_neutral(fit, spread)
        if unseen and not blind:  # undetermined parameters may have shown the effect
            start = self.params_at_neutral(self.chosen.named.params, unseen)
            sets = self.chosen.without.items()
            without = {name: replace(one, params=self.params_at_neutral(one.params, unseen)) for name, one in sets}
            fit, spread = self.fit(self.chosen.effect_names, start, frozenset(unseen))
            blind = self.effects_near_neutral(fit, spread)
            if not blind:
                return replace(self.chosen, without=without), fit, spread
        if blind:  # the complete fit determines none of their parameters, or not that one differs from neutral
            name = min(blind)
            neutral = neutral_params(name, self.declared, self.predictor.robot)
            self.chosen = self.chosen.without_undetermined_effect(name, neutral, Finding(code, name))
            return self.fit_determined()
        return self.chosen, fit, spread

    def find_ties(self, fit: ModelFit, names: Sequence[str]) -> tuple[ValueTie, ...]:
        """Return the combinations of effects on declared values that explain the flights as well as a fit.

        They are among ``names``, and effects that look like a fitted one and are no candidates for that reason.
        """
        best = self.chosen.best
        unasked = (name for name in EFFECTS if name not in (*names, *default_effects()))
        names = [*names, *(name for name in unasked if set(EFFECTS.get(name).confused_with).intersection(fit.effects))]
        return find_value_ties(
            self.predictor, self.declared, fit, self.beside, names,
            window=occam_window(best), overdispersion=best.parameter_overdispersion,
        )  # fmt: skip

    def effects_near_neutral(self, fit: ModelFit, spread: Uncertainty) -> set[str]:
        """Return the effects of which no parameter that can show them has an interval without its neutral value (95 %)."""
        distinct = set[str]()
        for place, half_width in zip(spread.columns.tolist(), spread.half_width.tolist(), strict=True):
            name, number = fit.parameter_owners[place]
            neutral = neutral_params(name, self.declared, self.predictor.robot)[number]
            distance = abs(fit.params.effects[name][number] - neutral) / parameter_scales((name,))[number]
            decisive = EFFECTS.get(name).shown_by or (EFFECTS.get(name).parameters[number].name,)
            if distance > half_width and EFFECTS.get(name).parameters[number].name in decisive:
                distinct.add(name)
        return set(fit.effects) - distinct

    def params_at_neutral(self, params: ModelParams, places: Iterable[tuple[str, int]]) -> ModelParams:
        """Return model parameters with some, by effect and index, at their neutral values."""
        for name, place in places:
            if name in params.effects:
                values = params.effects[name].copy()
                values[place] = neutral_params(name, self.declared, self.predictor.robot)[place]
                params = params.with_effect(name, values)
        return params
