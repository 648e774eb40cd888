"""Which effects the flights ask for: those of the most probable set, fitted with their spread, and what speaks against them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import neutral_of
from aerial_gym.sim2real.identify.candidates.nuisance import offsets_of
from aerial_gym.sim2real.identify.candidates.testable import lacks
from aerial_gym.sim2real.identify.evidence.fitting import Fitted, Label
from aerial_gym.sim2real.identify.least_squares.covariance import shown, uncertainty
from aerial_gym.sim2real.identify.least_squares.derivatives import tolerance_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Fit, Frozen, fit_effects, linearise
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.least_squares.own_offsets import OwnOffsets
from aerial_gym.sim2real.identify.least_squares.weighted import Beside
from aerial_gym.sim2real.identify.selection.choose import Chosen, choose_effects
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE, Criteria, LeftOut, Scored
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress, silent


@dataclass(frozen=True, kw_only=True)
class Rival:
    """Another effect in the place of a named one."""

    effect: str
    fitted: Fitted
    """The most probable set with it and without the named one."""

    log_odds: float
    """Of that set over the most probable one, as far as flights agree, with what test flights say for it."""

    wider: bool
    """Whether it contains the named one as a case."""

    doubt: float = 0.0
    """What of the log odds test flights say for it."""

    @property
    def told_apart(self) -> bool:
        """Whether the named effect is clearly more probable."""
        return self.log_odds < -LEAST_SCORE

    @property
    def told_apart_by_training(self) -> bool:
        """Whether it would be without the test flights."""
        return self.log_odds - self.doubt < -LEAST_SCORE


def offered_effects() -> tuple[str, ...]:
    """Return the effects that are looked for where nobody says which."""
    return tuple(name for name in EFFECTS if EFFECTS.get(name).by_default)


@dataclass(frozen=True, kw_only=True)
class SelectionResult:
    """What the flights ask for."""

    declared: Scored
    final: Scored
    chosen: Chosen
    """The sets that were compared."""

    not_testable: dict[str, Finding]
    """Effects that these flights cannot show, with the reason."""

    left_out: LeftOut
    criteria: Criteria

    looked_for: tuple[str, ...] = field(default_factory=offered_effects)
    """Effects that were asked for."""

    doubt: dict[Label, float] = field(default_factory=dict)
    """By how much test flights make some sets more probable than the named one, in log odds, at least 0."""

    @property
    def accepted(self) -> tuple[str, ...]:
        """Return the named effects."""
        return self.final.effects

    @property
    def weights(self) -> Weighting:
        """Return what a row of each channel counts."""
        return self.chosen.weights

    @property
    def own_offsets(self) -> OwnOffsets:
        """Return the offsets that training flights have of their own."""
        return offsets_of(self.chosen.best.structures, self.left_out.channels, self.weights.weight)

    @property
    def surrogates(self) -> dict[str, str]:
        """Return the effects that only stand in for a structure that no effect has, and for which."""
        return self.chosen.surrogates

    def rivals_of(self, name: str) -> list[Rival]:
        """Return the others in the place of a named effect, the most probable first."""
        best, found = self.chosen.best, dict[str, Rival]()
        for fitted in self.chosen.holding:
            if name in fitted.effects:
                continue
            doubt = self.doubt.get(fitted.label, 0.0)
            odds = (fitted.log_posterior - best.log_posterior) / best.overdispersion + doubt
            for other in in_place_of(name, best.effects, fitted.effects):
                if other not in found or odds > found[other].log_odds:
                    wider = name in EFFECTS.get(other).contains
                    found[other] = Rival(effect=other, fitted=fitted, log_odds=odds, wider=wider, doubt=doubt)
        return sorted(found.values(), key=lambda rival: -rival.log_odds)

    def ties_of(self, name: str) -> list[Rival]:
        """Return those that cannot be told from it; what contains it is no other cause."""
        return [rival for rival in self.rivals_of(name) if not rival.told_apart and not rival.wider]


def in_place_of(name: str, best: Sequence[str], other: Sequence[str]) -> list[str]:
    """Return which effects of another set stand where a named one does in the best: its wider or narrower case if there is
    one, else those that are no case of what else the other set lacks.
    """
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
    """Return the effects that the training flights ask for, on top of the declared model.

    Args:
        predictor: Training flights.
        declared: The declared model.
        criteria: What is material.
        progress: Told what is being done.
        test: Effects that a log of these has not what they need for are left out; nothing else is taken from them.
        candidates: Effects that are looked for; None: all but those that say ``by_default = False``.

    Raises:
        ConfigError: If one of the candidates predicts nothing, and so cannot be looked for here.
        UnknownNameError: If there is no such effect.
    """
    named = offered_effects() if candidates is None else tuple(candidates)
    sought = [name for name in named if EFFECTS.get(name).is_selectable]
    if candidates is not None and len(sought) < len(named):
        wrong = next(name for name in named if name not in sought)
        if not EFFECTS.get(wrong).on_rigid:
            raise ConfigError(
                f"{wrong} acts on links where they are, and vehicles are taken as rigid in their reference pose here: a robot "
                "file with joints may hold it, but it cannot be asked for"
            )
        raise ConfigError(
            f"{wrong} is random and predicts no row: it is looked for in what remains, and cannot be asked for"
            if EFFECTS.get(wrong).random
            else f"{wrong} acts under water, and flights are in air: a robot file may hold it, but it cannot be asked for"
        )
    reasons = {name: lacks(name, predictor.robot, predictor.flights, test) for name in sought}
    able = [name for name in sought if not reasons[name]]
    chosen = choose_effects(predictor, declared, able, material=criteria.material, progress=progress)
    give_back_memory()
    scorer = _Scorer(predictor, declared, criteria, chosen)
    final, chosen = scorer.final()
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
    """Fits sets with their spread, and predicts flights left out."""

    def __init__(self, predictor: Predictor, declared: ModelParams, criteria: Criteria, chosen: Chosen) -> None:
        self.predictor, self.declared, self.chosen, self.weights = predictor, declared, chosen, chosen.weights
        self.tolerance = tolerance_jacobian(predictor, chosen.named.within, np.float32)
        weight = self.weights.weight
        self.offsets = offsets_of(chosen.best.structures, predictor.channels, weight)
        parts = [[part] for part in self.tolerance]
        self.beside = Beside(predictor.times, parts, weight, offsets=self.offsets)
        nothing = self._fit((), declared, frozenset())
        self.left_out = LeftOut(
            count=nothing.moments.count,
            flight=nothing.moments.flight,
            weights=self.weights,
            criteria=criteria,
            channels=predictor.channels,
            tolerated=chosen.tolerated,
        )
        self.nothing = self._scored(nothing)
        """The declared model."""

    def _fit(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen) -> Fit:
        found, _, _ = fit_effects(self.predictor, effects, start, self.beside, frozen=frozen)
        by_channel = linearise(self.predictor, effects, found.params, self.tolerance, offsets=self.offsets)
        return replace(by_channel, frozen=frozen)

    def score(self, effects: tuple[str, ...], start: ModelParams, frozen: Frozen = frozenset()) -> Scored:
        """Return the model with these effects fitted, and its squares on flights left out."""
        return self._scored(self._fit(effects, start, frozen))

    def _scored(self, fit: Fit) -> Scored:
        spread, left_out = uncertainty(fit, self.weights.weight), self.left_out.squares(fit)
        by_flight = replace(fit, moments=fit.moments.joined(fit.moments.flight))  # no more of it is asked for any more
        return Scored(fit=by_flight, spread=spread, left_out=left_out)

    def final(self) -> tuple[Scored, Chosen]:
        """Return the named effects fitted, and the choice; parameters that the flights do not show are neutral in both."""
        scored = self.score(self.chosen.effects, self.chosen.named.params)
        unseen = unidentified_parameters(scored)
        if not unseen:
            return scored, self.chosen
        seen = {scored.fit.owners[k] for k in scored.fit.free_effects} - unseen
        blind = set(self.chosen.effects).difference(name for name, _ in seen)
        if blind:  # of these not even one parameter is shown once they are fitted to the end
            name = min(blind)
            neutral = neutral_of(name, self.declared, self.predictor.robot)
            self.chosen = self.chosen.without_blind(name, neutral)
            return self.final()
        scored = self.score(self.chosen.effects, self.at_neutral(self.chosen.named.params, unseen), frozenset(unseen))
        without = {
            name: replace(less, params=self.at_neutral(less.params, unseen))
            for name, less in self.chosen.without.items()
        }
        return scored, replace(self.chosen, without=without)

    def at_neutral(self, params: ModelParams, places: Iterable[tuple[str, int]]) -> ModelParams:
        """Return parameters of which some, by effect and place, change nothing."""
        for name, place in places:
            if name in params.effects:
                values = params.effects[name].copy()
                values[place] = neutral_of(name, self.declared, self.predictor.robot)[place]
                params = params.with_effect(name, values)
        return params


def unidentified_parameters(scored: Scored) -> set[tuple[str, int]]:
    """Return the fitted parameters, effect and place, that the flights leave unknown by more than their scale."""
    owners = scored.fit.owners
    return {owners[k] for k in scored.fit.free_effects[~shown(scored.spread.plain)]}
