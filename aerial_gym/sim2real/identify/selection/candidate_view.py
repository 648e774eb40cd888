"""All candidates linearised about a fitted set, with the sets fitted there and the rule for further fits."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from aerial_gym.sim2real.identify.candidates.library import Library
from aerial_gym.sim2real.identify.candidates.nuisance import NuisanceColumns
from aerial_gym.sim2real.identify.evidence.fitting import (
    ENOUGH,
    EffectSetFit,
    Fitter,
    Label,
    label_of_candidate_set,
)
from aerial_gym.sim2real.identify.evidence.guard import Guard
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.evidence.search import SetPosterior
from aerial_gym.sim2real.identify.least_squares.gauss_newton import MOST_TO_PROMISE, StopRule
from aerial_gym.sim2real.identify.selection.criteria import LEAST_SCORE
from aerial_gym.sim2real.memory import give_back_memory

FAR_BEHIND = 3.0  # Multiple of ``occam_window`` by which a negligible set is less probable: odds of 1e-4
Way = Callable[["CandidateView"], None]  # Search strategy: fits sets that may be more probable than the present one


@dataclass(frozen=True, kw_only=True)
class CandidateView:
    """All candidates linearised about the present set, and the sets that were fitted."""

    present: EffectSetFit
    fits: dict[Label, EffectSetFit]  # All sets that were fitted with the present weights, including the present set
    own: dict[Label, Fitter]  # Fitters of the sets whose tolerances are linearised about the set itself
    fresh: set[Label]  # Sets that were fitted with the tolerances linearised about the present set
    fitter: Fitter
    library: Library
    structures: list[NuisanceColumns]
    sets: SetPosterior
    guard: Guard
    gone: list[Way] = field(default_factory=list)  # Strategies that found no more probable set than the present one

    @property
    def present_set(self) -> Model:
        """Return the indices of the candidates in the present set."""
        return candidates_of_fit(self.library, self.present)

    @property
    def best_fit(self) -> EffectSetFit:
        """Return the most probable fitted set whose effects are all supported."""
        return max((fitted for fitted in self.fits.values() if fitted.is_supported), key=lambda one: one.log_posterior)

    @property
    def best_fit_without_structures(self) -> EffectSetFit:
        """Return the most probable of these sets without structures, except offsets of flights."""
        bare = (fitted for fitted in self.fits.values() if fitted.is_supported and fitted.has_no_structures_but_offsets)
        return max(bare, key=lambda one: one.log_posterior)

    def has_fit(self, label: Label) -> bool:
        """Return whether a set was fitted with comparable tolerances: linearised about the present set or about itself."""
        return label in self.fresh or label in self.own

    def sets_elsewhere(self, models: Sequence[Model], least: float) -> list[EffectSetFit]:
        """Return the sets, fitted however far, a deviation of which differs by ``least`` from the present set's."""
        here = self.present.deviation
        for model in models:
            self.fit_if_promising(model, however_far=True)
        labels = sorted({label_of_candidate_set(self.library, model) for model in models}.difference(self.own))
        fits = [self.fits[label] for label in labels if label in self.fresh]
        fits = [one for one in fits if one.deviation.size == here.size]  # none from a fit that failed
        return [one for one in fits if np.any(np.abs(one.deviation - here) >= least)]

    def fit_if_promising(self, model: Model, *, however_far: bool = False) -> None:
        """Fit a new set that may come near the best, with ``MOST_TO_PROMISE`` times its linear gain, or ``however_far``."""
        behind, here = self.sets.log_posteriors([model, self.present_set])
        if self.has_fit(label_of_candidate_set(self.library, model)):
            return
        beside = any(self.library.candidates[k].is_common_structure for k in model)
        rule = self.stop_rule_of_comparison(beside=beside)
        if however_far or self.present.log_posterior - (here - behind) / MOST_TO_PROMISE > rule.least:
            self.add_fit(self.fitter.fit_set(self.library, self.sets, model, self.structures, rule))

    def stop_rule_of_comparison(self, *, beside: bool) -> StopRule:
        """Return the stopping rule of a fit, relative to the best set with structures (``beside``) or without."""
        best = self.best_fit if beside else self.best_fit_without_structures
        least = best.log_posterior - FAR_BEHIND * occam_window(best)
        return StopRule(least=least, enough=ENOUGH * best.parameter_overdispersion)

    def add_fit(self, fitted: EffectSetFit) -> None:
        """Add a fitted set, and sets without its weakest effects while one lacks support and a subset may be near the best."""
        while not self.has_fit(fitted.label):
            self.fits[fitted.label] = fitted
            self.fresh.add(fitted.label)
            rule = self.stop_rule_of_comparison(beside=not fitted.has_no_structures_but_offsets)
            if fitted.effects and not fitted.is_supported and fitted.most > rule.least:
                fitted = self.fitter.refit_without_weakest(fitted, rule)

    def add_relinearised_fit(self, fitted: EffectSetFit, fitter: Fitter) -> None:
        """Add a set linearised about itself; without support, also the set without its weakest effect if that may be near."""
        self.own[fitted.label], self.fits[fitted.label] = fitter, fitted
        if not fitted.is_supported:
            fitter.clear_caches()  # a set without support is never the best, and its fitter takes memory
            least = self.stop_rule_of_comparison(beside=not fitted.has_no_structures_but_offsets).least
            if fitted.effects and fitted.most > least:  # a fit may fail without effects, too
                self.add_fit(self.fitter.refit_without_weakest(fitted))

    def free_memory(self) -> None:
        """Free the memory that is not needed after the search about this set has ended."""
        self.library.tangents.clear()
        free_other_fitters(self.own, self.present.label)
        self.fitter.clear_nuisance_sums()
        give_back_memory()


def free_other_fitters(own: Mapping[Label, Fitter], *kept: Label) -> None:
    """Free the memory of all fitters except those of the labels ``kept``."""
    for label, fitter in own.items():
        if label not in kept:
            fitter.clear_caches()


def occam_window(fitted: EffectSetFit) -> float:
    """Return the difference in log posterior below which sets are not distinct: ``LEAST_SCORE`` times overdispersion.

    Source: Madigan, Raftery (1994), Model selection and accounting for model uncertainty in graphical models using Occam's
    window, Journal of the American Statistical Association 89.
    """
    return LEAST_SCORE * fitted.parameter_overdispersion


def candidates_of_fit(library: Library, present: EffectSetFit) -> Model:
    """Return the indices of the candidates that a fitted set contains."""
    beside = {structure.name for structure in present.structures}
    candidates = enumerate(library.candidates)
    return tuple(k for k, one in candidates if one.named or (one.structure and one.name in beside))


def rival_sets(view: CandidateView) -> Iterator[dict[Model, float]]:
    """Yield, for each present effect, the sets with another one in its place and their log posterior in the linear model.

    An effect of one rotor may also be in the place of itself on another rotor.
    """
    candidates, present = view.library.candidates, view.present_set
    new = [k for k, one in enumerate(candidates) if not one.structure and k not in present]
    for gone in (k for k in present if not candidates[k].structure):
        replacements = [
            k
            for k in new
            if candidates[k].name not in view.present.effects or candidates[k].name == candidates[gone].name
        ]
        models = [tuple(sorted((*(k for k in present if k != gone), other))) for other in replacements]
        yield dict(zip(models, view.sets.log_posteriors(models).tolist(), strict=True))
