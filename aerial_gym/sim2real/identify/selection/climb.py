"""The way to the most probable set of effects.

All candidates are linearised about the present model; the posterior over sets tells which are worth a fit; each of these is
fitted as it is, not linearised, and its evidence taken there. The best becomes the present model, until none is better.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.identify.candidates.library import Tangent, build_library, has_starts, tangents_about
from aerial_gym.sim2real.identify.candidates.nuisance import Nuisance, Nuisances, beyond_structures, most_of_flights
from aerial_gym.sim2real.identify.evidence.fitting import Fitted, Fitter, Label, label_in
from aerial_gym.sim2real.identify.evidence.guard import Guard, parts_of_a_flight
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.evidence.linear import candidates_of, normal_of
from aerial_gym.sim2real.identify.evidence.search import search
from aerial_gym.sim2real.identify.least_squares.derivatives import Derivatives, single, tolerance_jacobian, tolerated
from aerial_gym.sim2real.identify.least_squares.moments import Weighting
from aerial_gym.sim2real.identify.least_squares.weighted import InChannels
from aerial_gym.sim2real.identify.least_squares.weighting import weighting
from aerial_gym.sim2real.identify.selection.view import View, Way, forget_but, occam_window, place_of
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress

MOST_IN_VAIN = 5
"""Sets that are fitted one after the other without one that is better."""

MOST_RIVALS = 3
"""Other effects that are fitted in the place of one."""

MOST_ROUNDS = 8
MOST_WEIGHINGS = 3
SAME_DEVIATION = 0.5
"""A set is fitted about itself until no deviation within the tolerances moves by more than so many standard deviations."""

MOST_TURNS = 4
"""Fits of a set about itself: where the first was on time and a sensor is two deviations late, the third stays."""

SETTLED = 0.3
"""The weights of the channels are taken anew until none changes by more than this on the scale of the logarithm."""


class Climber:
    """Goes from set to set until none is better."""

    view: View
    """All candidates about where it is. They take memory: those about the set before are let go of first."""

    _weighed: tuple[ModelParams, Weighting]
    """The last model whose weights were taken, and these."""

    def __init__(self, predictor: Predictor, declared: ModelParams, names: Sequence[str], progress: Progress) -> None:
        """Take training flights, the declared model, and the effects that may be in a set."""
        self.predictor, self.declared, self.names, self.progress = predictor, declared, tuple(names), progress
        tolerance = tolerance_jacobian(predictor, declared)
        self.tolerated, self._tolerance = tolerated(tolerance, predictor.robot.num_rotors), single(tolerance)
        self.missed, most = predictor.residuals(declared), most_of_flights(predictor, self.tolerated)
        self.nuisances = Nuisances(predictor.flights, predictor.times, predictor.channels, self.missed, most)
        self.skipped = tuple(name for name in EFFECTS if name not in self.names)

    def run(self) -> View:
        """Climb with the weights that the best model leaves, until these no longer change.

        Only then are rivals fitted, which are many and seldom better.
        """
        likely = (self.fit_probable, self.fit_fewer)
        self.view = self.start()
        for ways in (likely, (*likely, self.fit_rivals, self.fit_nearest)):
            for left in reversed(range(MOST_WEIGHINGS)):
                self.climb(ways)
                weights = self.weights_about(self.view)
                change = np.log(weights.weight / self.view.fitter.weights.weight)
                if not left or np.all(np.abs(change) < SETTLED):
                    break
                self.view.let_go()
                present = self.view.present
                del self.view
                self.view = self.start_from(present.within, present.effects, present.structures, weights)
        last = self.view
        last.let_go()
        del self.view  # whose ways are the climber's: neither would go
        return last

    def start(self) -> View:
        """Return all candidates about the declared model, under the weights that it leaves."""
        tangents = tangents_about(self.predictor, self.declared, self.declared, skipped=self.skipped)
        tolerance = self._tolerance
        del self._tolerance  # it is asked for once, and takes memory
        self._weighed = self.declared, self.weigh(self.declared, tangents, tolerance)
        return self.start_from(self.declared, (), (), self._weighed[1], tangents, tolerance)

    def weights_about(self, view: View) -> Weighting:
        """Return the weights that a model leaves; those of the last one are known."""
        params = view.present.params
        if params is not self._weighed[0]:
            view.fitter.forget_beside()
            give_back_memory()
            self._weighed = params, self.weigh(params, view.library.tangents, view.fitter.tolerance)
        return self._weighed[1]

    def weigh(self, params: ModelParams, tangents: Sequence[Tangent], tolerance: Derivatives) -> Weighting:
        """Return the weights of the channels from what all effects and structures together leave over."""
        several = [one for one in tangents if has_starts(one.name, self.predictor.robot)]
        common = [one for one in tangents if not has_starts(one.name, self.predictor.robot)]
        start = params
        for one in common:
            start = start.with_effect(one.name, one.start)

        def beyond(residuals: list[Array], weights: Weighting) -> list[Array]:
            return beyond_structures(self.nuisances.beside(residuals, {}), residuals, weights)

        channels = len(self.predictor.channels)
        linear = [tolerance, *(one.whole(channels) for one in several if one.name not in params.effects)]
        nothing = [np.empty((*residual.shape, 0)) for residual in self.missed]
        whole = [one.whole(channels) for one in common]
        own = [np.concatenate(parts, axis=2) for parts in zip(nothing, *whole, strict=True)]
        del whole
        return weighting(self.predictor, start, tuple(one.name for one in common), own, linear, beyond=beyond)

    def start_from(
        self,
        params: ModelParams,
        effects: tuple[str, ...],
        structures: tuple[Nuisance, ...],
        weights: Weighting,
        tangents: list[Tangent] | None = None,
        tolerance: Derivatives | None = None,
    ) -> View:
        """Return all candidates about a set, with the deviations that it has, or about what holds of it under these weights."""
        fitter, start = self.fitter_about(params, weights), replace(params, deviation=None)
        fitter.tolerance = tolerance
        present, nothing = fitter.fit(effects, structures, start), fitter.fit((), (), self.declared)
        while not present.holds:
            present = fitter.without_weakest(present)
        return self.view_about(present, {present.label: fitter}, {nothing.label: nothing}, tangents)

    def climb(self, ways: Sequence[Way]) -> None:
        """Go to the best set that fits lead to from the present one."""
        for count in range(MOST_ROUNDS):
            self.progress(f"sets of effects, round {count + 1}", count / MOST_ROUNDS)
            present, own, fits = self.view.present, self.view.own, self.view.fits
            for more in (way for way in ways if way not in self.view.gone):
                settled = -1
                while settled != len(own) and self.leader(self.view) is present:  # else what looked best was not
                    settled = len(own)
                    more(self.view)
                    self.leader(self.view)
                self.view.gone.append(more)
            if (leader := self.leader(self.view)) is present:
                return
            del self.view
            give_back_memory()
            self.view = self.view_about(leader, own, fits)

    def fitter_about(self, params: ModelParams, weights: Weighting) -> Fitter:
        """Return what fits sets with the tolerances linear about a model."""
        return Fitter(self.predictor, self.declared, len(self.names), weights, params)

    def leader(self, view: View) -> Fitted:
        """Return the best fitted set, each that comes first fitted again with the tolerances linear about itself."""
        while (best := view.best).label not in view.own:
            forget_but(view.own, view.present.label)
            view.settle(*self.about_itself(best, view.fitter))
        forget_but(view.own, view.present.label, best.label)
        return best

    def about_itself(self, fitted: Fitted, about: Fitter) -> tuple[Fitted, Fitter]:
        """Return a set fitted with the tolerances linear about itself, until its deviations stay, and what fits it there.

        About a model on time, sensors that are 6 ms late are so in part; what is left looks like a delay of the commands. Where
        a turn moves them further than the one before, as of late noise, turns lead away, and the one before is the last.
        """
        last = np.inf
        for _ in range(MOST_TURNS):
            about.forget_beside()
            fitter = self.fitter_about(fitted.within, about.weights)
            again = fitter.again(fitted, about)
            if not again.deviation.size:  # it went nowhere
                return again, fitter
            moved = float(np.abs(again.deviation - fitted.deviation).max())
            if moved > last:
                break
            fitted, about, last = again, fitter, moved
            if moved < SAME_DEVIATION:
                break
        return fitted, about

    def fit_probable(self, view: View) -> None:
        """Fit the sets that are probable about a model.

        A fit takes from a set what its linear model promised too much. So sets are fitted in the order of what they promise,
        until none promises more than the best one holds, or several in a row have not held it. Several structures together
        can make what an effect with a memory or a range makes, better than the effect where it is linear: sets without
        structures, but for offsets of flights, have their own turn.
        """
        values = view.sets.log_posterior
        structures = {k for k, one in enumerate(view.library.candidates) if one.in_common}
        order = sorted(values, key=values.__getitem__, reverse=True)
        bare, seen = [model for model in order if not structures.intersection(model)], set[Label]()
        for turn, best_of_turn in ((order, lambda: view.best), (bare, lambda: view.best_bare)):
            vain, best = 0, best_of_turn()
            for model in turn:
                if vain == MOST_IN_VAIN or values[model] <= best.log_posterior:
                    break
                label = label_in(view.library, model)
                if label in seen or view.known(label):
                    continue
                seen.add(label)
                view.fit(view.guard.held(model))
                before, best = best, best_of_turn()
                vain = vain + 1 if best is before else 0

    def fit_fewer(self, view: View) -> None:
        """Fit the sets with an effect less than the present one, and with a narrower case of an effect."""
        for gone in (k for k in view.here if not view.library.candidates[k].structure):
            view.fit(tuple(k for k in view.here if k != gone))
        compared = view.compared(beside=not view.present.bare)
        for fitted in view.fitter.narrower(view.present, self.names, compared):
            view.add(fitted)

    def fit_rivals(self, view: View) -> None:
        """Fit the best sets with another effect in the place of one of the present that may be as probable."""
        least = view.present.log_posterior - occam_window(view.present)
        for values in swaps(view):
            for model in sorted(values, key=values.__getitem__, reverse=True)[:MOST_RIVALS]:
                if values[model] > least:
                    view.fit(model)

    def fit_nearest(self, view: View) -> None:
        """Fit the best set with another effect in the place of each of the present, however far it is behind.

        It is what a reader would ask for.
        """
        for values in swaps(view):
            best = max(values, key=values.__getitem__, default=())
            if np.isfinite(values.get(best, -np.inf)):
                view.fit(best, however_far=True)

    def view_about(
        self,
        present: Fitted,
        own: dict[Label, Fitter],
        fits: dict[Label, Fitted],
        tangents: list[Tangent] | None = None,
    ) -> View:
        """Return all candidates about a model, the posterior over their sets, and the structures among them."""
        structures, fitter = list[Nuisance](), own[present.label]
        forget_but(own, present.label)

        def of_residuals(residuals: list[Array], effects: dict[str, list[list[InChannels]]]) -> list[Nuisance]:
            structures.extend(self.nuisances.beside(residuals, effects))
            return structures

        library = build_library(
            self.predictor,
            self.declared,
            present.params,
            present.effects,
            fitter.weights.weight,
            skipped=self.skipped,
            structures=of_residuals,
            tangents=tangents,
            tolerance=fitter.tolerance,
            parts=parts_of_a_flight(len(self.predictor.times)),
        )
        sets = search(candidates_of(library), normal_of(library), starts=[place_of(library, present)])
        fits[present.label] = present
        return View(
            present=present,
            fits=fits,
            own=own,
            fresh=set(),
            fitter=fitter,
            library=library,
            structures=structures,
            sets=sets,
            guard=Guard(library, sets),
        )


def swaps(view: View) -> Iterator[dict[Model, float]]:
    """Yield for each present effect the sets with another one in its place, and how probable the linear model has them."""
    candidates = view.library.candidates
    others = [k for k, one in enumerate(candidates) if not one.structure and one.name not in view.present.effects]
    for gone in (k for k in view.here if not candidates[k].structure):
        models = [tuple(sorted((*(k for k in view.here if k != gone), other))) for other in others]
        yield dict(zip(models, view.sets.log_posterior_of(models).tolist(), strict=True))
