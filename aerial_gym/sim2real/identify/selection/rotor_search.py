"""The proven set: named effects that the flights show despite their scatter, each on the rotor with the largest odds.

The most probable set may hold unproven effects, and beside these a wrong rotor. So after their removal, each effect of that
set is tried again on every rotor. An addition is judged by its robust log odds (``Support.log_odds_with_overdispersion``), as
evidence overstates what the flights do not share. Two rotors are compared by their evidence over the larger overdispersion of
both: of few flights each is known to its order only, so that odds with one for each rotor differ by chance.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import special

from aerial_gym.sim2real.identify.candidates.library import is_of_one_rotor
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, set_label
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.selection.candidate_view import CandidateView
from aerial_gym.sim2real.identify.selection.criteria import LEAST_NAMING_ODDS, LEAST_SCORE

MOST_TRIED = 3  # Largest number of full fits for one place in a set, the best ones by the linear model
MOST_CHANGES = 8  # Largest number of changes of a set


def effect_odds(fitted: EffectSetFit, present: EffectSetFit, most: Mapping[str, float]) -> dict[str, float]:
    """Return the robust log odds of each effect of a set: the larger of those in it and in the most probable set.

    Without structures, their part of the residual looks like scatter between flights. ``most``: limits of the odds
    (``odds_against_parts``).
    """
    results = {name: support.log_odds_with_overdispersion for name, support in fitted.support.items()}
    for name in results.keys() & present.support.keys():
        if label_of_effect(fitted, name) in present.label:  # the same rotor
            odds = max(results[name], present.support[name].log_odds_with_overdispersion)
            results[name] = min(odds, most.get(name, np.inf))
    return results


def odds_against_parts(present: EffectSetFit, fits: Iterable[EffectSetFit]) -> dict[str, float]:
    """Return the log odds of a set against its fitted parts without each effect, for effects with such a part.

    Odds by derivatives about a set do not see tolerances that do elsewhere what the effect does here.
    """
    structures = {one.name for one in present.structures}
    parts = [
        one
        for one in fits
        if one.is_supported and structures.issuperset(structure.name for structure in one.structures)
    ]
    results = dict[str, float]()
    for name in present.effects:
        rest = set(present.effects) - {name}
        likely = max((one.log_posterior for one in parts if rest.issuperset(one.effects)), default=-np.inf)
        if np.isfinite(likely):
            results[name] = (present.log_posterior - likely) / present.parameter_overdispersion
    return results


def label_of_effect(fitted: EffectSetFit, name: str) -> str:
    """Return the label of one effect of a set, with its rotor."""
    return set_label([(name, fitted.params.effects[name])], ())[0]


def is_proven(fitted: EffectSetFit, present: EffectSetFit, most: Mapping[str, float]) -> bool:
    """Return whether the log odds of all effects of a set exceed ``LEAST_NAMING_ODDS``."""
    odds = effect_odds(fitted, present, most).values()
    return fitted.is_supported and all(one > LEAST_NAMING_ODDS for one in odds)


@dataclass(frozen=True)
class PossibleEffect:
    """An effect that the flights neither prove nor exclude beside a set."""

    name: str
    log_odds: float  # Robust log odds of the set with it
    fitted: EffectSetFit  # The set with it
    without: EffectSetFit  # The set without it

    def shift(self, name: str, place: int) -> float:
        """Return the change of one parameter of the set that the effect causes."""
        return float(self.fitted.params.effects[name][place] - self.without.params.effects[name][place])


def variance_between_sets(possible: Sequence[PossibleEffect], name: str, place: int) -> float:
    """Return the variance of one parameter of a set about its value, over the set and those with a possible effect.

    A set that has lost an effect since keeps these shifts, as its own change comes from that loss.
    Source: Hoeting, Madigan, Raftery, Volinsky (1999), Bayesian model averaging: a tutorial, Statistical Science 14, eq. 3.
    """
    shares = special.softmax([0.0, *(one.log_odds for one in possible)])[1:]
    return float(shares @ np.array([one.shift(name, place) for one in possible]) ** 2)


@dataclass(frozen=True)
class RotorSearch:
    """Changes of a proven set by one effect."""

    view: CandidateView
    pool: frozenset[str]  # Effects that may be added: those of the most probable set without surrogates
    most: Mapping[str, float] = field(default_factory=dict)  # Limits of the log odds (``effect_odds``)

    def best_set(self, fitted: EffectSetFit) -> EffectSetFit:
        """Return the set after exchanges of effects of one rotor, then additions, until none is proven and better."""
        for _ in range(MOST_CHANGES):
            for change in (self.exchanges, self.additions):
                gains = [
                    (gain, one)
                    for gain, one in change(fitted)
                    if gain > 0.0 and is_proven(one, self.view.present, self.most)
                ]
                if gains:
                    fitted = max(gains, key=lambda pair: pair[0])[1]
                    break
            else:
                break
        return fitted

    def additions(self, fitted: EffectSetFit) -> Iterator[tuple[float, EffectSetFit]]:
        """Yield sets with one more effect, each with its log odds above ``LEAST_NAMING_ODDS``."""
        for name, one in self._larger_sets(fitted, self.pool.difference(fitted.effects)):
            yield one.support[name].log_odds_with_overdispersion - LEAST_NAMING_ODDS, one

    def exchanges(self, fitted: EffectSetFit) -> Iterator[tuple[float, EffectSetFit]]:
        """Yield sets with an effect of one rotor on another rotor or as another one, each with its log odds over the set."""
        for gone in filter(is_of_one_rotor, fitted.effects):
            names = {gone, *filter(is_of_one_rotor, self.pool.difference(fitted.effects))}
            less = self.view.fitter.refit_without_effects(fitted, (gone,))
            for name, one in self._larger_sets(less, names, label_of_effect(fitted, gone)):
                scatter = max(1.0, fitted.support[gone].overdispersion, one.support[name].overdispersion)
                yield (one.log_posterior - fitted.log_posterior) / scatter, one

    def ties(self, fitted: EffectSetFit) -> dict[str, tuple[str, ...]]:
        """Return the labels of effects on other rotors that are not clearly less probable, by the effect of one rotor."""
        results = dict[str, tuple[str, ...]]()
        for gain, one in self.exchanges(fitted):
            (gone,) = (name for name in fitted.effects if label_of_effect(fitted, name) not in one.label)
            (new,) = (name for name in one.effects if label_of_effect(one, name) not in fitted.label)
            if gain > -LEAST_SCORE and one.is_supported:
                results[gone] = (*results.get(gone, ()), label_of_effect(one, new))
        return results

    def possible_additions(self, fitted: EffectSetFit) -> tuple["PossibleEffect", ...]:
        """Return the unproven effects that may act beside a set, on every rotor: their odds exceed ``-LEAST_SCORE``."""
        rotors = {one.name for one in self.view.library.candidates if not one.structure and is_of_one_rotor(one.name)}
        names = sorted((self.pool | rotors).difference(fitted.effects))  # Each by itself: none crowds out another
        sets = (pair for own in names for pair in self._larger_sets(fitted, (own,), least=-LEAST_SCORE))
        results = (
            PossibleEffect(name, one.support[name].log_odds_with_overdispersion, one, fitted) for name, one in sets
        )
        return tuple(one for one in results if one.log_odds > -LEAST_SCORE)

    def _larger_sets(
        self, base: EffectSetFit, names: Collection[str], gone: str = "", *, least: float = 0.0
    ) -> Iterator[tuple[str, EffectSetFit]]:
        """Yield the fits of a set with one more effect of some names but for a label, the best by the linear model.

        Its log odds in the linear model are above ``least``.
        """
        library, guard, whole = self.view.library, self.view.guard, self._candidate_indices(base)
        new = [k for k, one in enumerate(library.candidates) if one.name in names and not one.structure]
        new = [k for k in new if set_label([(library.candidates[k].name, library.candidates[k].start)], ())[0] != gone]
        odds = {k: guard.support(tuple(sorted((*whole, k))))[k].log_odds_with_overdispersion for k in new}
        for k in sorted((k for k in new if odds[k] > least), key=odds.__getitem__, reverse=True)[:MOST_TRIED]:
            candidate, fitter = library.candidates[k], self.view.fitter
            start = base.params.with_effect(candidate.name, candidate.start)
            yield candidate.name, fitter.fit((*base.effects, candidate.name), base.structures, start)

    def _candidate_indices(self, fitted: EffectSetFit) -> Model:
        """Return the indices of the candidates of a set."""
        names = {*(label_of_effect(fitted, name) for name in fitted.effects), *(one.name for one in fitted.structures)}
        labels = (
            one.name if one.structure else set_label([(one.name, one.start)], ())[0]
            for one in self.view.library.candidates
        )
        return tuple(k for k, label in enumerate(labels) if label in names)
