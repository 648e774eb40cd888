"""All candidates about a fitted set: which sets were fitted there, and how far others are worth a fit."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from aerial_gym.sim2real.identify.candidates.library import Library
from aerial_gym.sim2real.identify.candidates.nuisance import Nuisance
from aerial_gym.sim2real.identify.evidence.fitting import ENOUGH, Compared, Fitted, Fitter, Label, label_in
from aerial_gym.sim2real.identify.evidence.guard import Guard
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.evidence.search import Sets
from aerial_gym.sim2real.identify.least_squares.gauss_newton import MOST_TO_PROMISE
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE
from aerial_gym.sim2real.memory import give_back_memory

FAR_BEHIND = 3.0
"""Times ``occam_window`` that a set is behind another one of which it cannot take any of the probability: odds of 1e-4."""

Way = Callable[["View"], None]
"""Fits sets that may be better than the present one."""


@dataclass(frozen=True, kw_only=True)
class View:
    """All candidates about a fitted set."""

    present: Fitted
    fits: dict[Label, Fitted]
    """All sets that were fitted under these weights, this one among them."""

    own: dict[Label, Fitter]
    """Of the sets that were fitted with the tolerances linear about themselves: what fits them there."""

    fresh: set[Label]
    """Sets that were fitted with the tolerances linear about the present one."""

    fitter: Fitter
    library: Library
    structures: list[Nuisance]
    sets: Sets
    guard: Guard

    gone: list[Way] = field(default_factory=list)
    """Ways that lead nowhere from here."""

    @property
    def here(self) -> Model:
        """Return the set of the candidates that the present model holds."""
        return place_of(self.library, self.present)

    @property
    def best(self) -> Fitted:
        """Return the best of the fitted sets that hold."""
        return max((fitted for fitted in self.fits.values() if fitted.holds), key=lambda one: one.log_posterior)

    @property
    def best_bare(self) -> Fitted:
        """Return the best of those without structures but offsets of flights."""
        bare = (fitted for fitted in self.fits.values() if fitted.holds and fitted.bare)
        return max(bare, key=lambda one: one.log_posterior)

    def known(self, label: Label) -> bool:
        """Return whether a set was fitted with the tolerances linear about the present model or about itself.

        Evidences with the tolerances linear about models that are far apart are not comparable.
        """
        return label in self.fresh or label in self.own

    def fit(self, model: Model, *, however_far: bool = False) -> None:
        """Fit a set that is not known, from the best of its starts, if it may come near the best or ``however_far`` it is.

        What the linear model has a set behind the present one is less once that is fitted, as any step may gain more than was
        promised.
        """
        behind, here = self.sets.log_posterior_of([model, self.here])
        if self.known(label_in(self.library, model)):
            return
        beside = any(self.library.candidates[k].in_common for k in model)
        compared = self.compared(beside=beside)
        if however_far or self.present.log_posterior - (here - behind) / MOST_TO_PROMISE > compared.least:
            self.add(self.fitter.fit_of(self.library, self.sets, model, self.structures, compared))

    def compared(self, *, beside: bool) -> Compared:
        """Return how far a set beside structures, or without any, is fitted: it must be able to come near the best."""
        best = self.best if beside else self.best_bare
        least = best.log_posterior - FAR_BEHIND * occam_window(best)
        return Compared(least=least, enough=ENOUGH * best.overdispersion)

    def add(self, fitted: Fitted) -> None:
        """Take a fitted set, and as long as it does not hold, the same without the effect for which the least speaks.

        No set with fewer effects is tried where none can come near the best.
        """
        while not self.known(fitted.label):
            self.fits[fitted.label] = fitted
            self.fresh.add(fitted.label)
            compared = self.compared(beside=not fitted.bare)
            if not fitted.holds and fitted.most > compared.least:
                fitted = self.fitter.without_weakest(fitted, compared)

    def settle(self, fitted: Fitted, fitter: Fitter) -> None:
        """Take a set fitted about itself, and where it does not hold, the same without what does not, fitted as any other."""
        self.own[fitted.label], self.fits[fitted.label] = fitter, fitted
        if not fitted.holds:
            fitter.forget()  # it is never the best, and what fits it takes memory
            self.add(self.fitter.without_weakest(fitted))

    def let_go(self) -> None:
        """Let go of what takes memory and is not needed once the climb has ended."""
        self.library.tangents.clear()
        forget_but(self.own, self.present.label)
        self.fitter.forget_beside()
        self.fitter.tolerance = None
        give_back_memory()


def forget_but(own: Mapping[Label, Fitter], *kept: Label) -> None:
    """Let what fits sets about themselves, all but some, let go of what takes memory."""
    for label, fitter in own.items():
        if label not in kept:
            fitter.forget()


def occam_window(fitted: Fitted) -> float:
    """Return by how much log posterior another set may be behind one and not be told from it: odds of ``LEAST_SCORE``.

    Source:
        Madigan, Raftery (1994), Model selection and accounting for model uncertainty in graphical models using Occam's
        window, Journal of the American Statistical Association 89.
    """
    return LEAST_SCORE * fitted.overdispersion


def place_of(library: Library, present: Fitted) -> Model:
    """Return the set of the candidates that the present model holds."""
    beside = {structure.name for structure in present.structures}
    return tuple(
        k for k, found in enumerate(library.candidates) if found.named or (found.structure and found.name in beside)
    )
