"""Which effects the flights ask for: the most probable set of effects, fitted, and how probable each is.

All candidates are linearised about the present model; the posterior over sets tells which are worth a fit; each of these is
fitted as it is, not linearised, and its evidence taken there. The best becomes the present model, until none is better.
Every effect must hold against the scatter between flights, and be worth more than a trifle.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.candidates.library import (
    Library,
    build_library,
    columns_of_starts,
    has_starts,
    neutral_of,
    seen_candidates,
)
from aerial_gym.sim2real.identify.candidates.nuisance import (
    Nuisance,
    beyond_structures,
    functions_of,
    structures_of,
)
from aerial_gym.sim2real.identify.candidates.testable import noise_shares
from aerial_gym.sim2real.identify.evidence.fitting import (
    Fitted,
    Fitter,
    Label,
    inclusion_in,
    label_in,
    narrowest,
    probabilities_of,
)
from aerial_gym.sim2real.identify.evidence.guard import Guard, part_length, parts_of
from aerial_gym.sim2real.identify.evidence.laplace import Model, Posterior, posterior
from aerial_gym.sim2real.identify.evidence.linear import candidates_of, linear_about, normal_of, with_structures
from aerial_gym.sim2real.identify.evidence.search import Sets, search
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    effect_jacobian,
    fit_at,
    tolerance_jacobian,
    weighting,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, flight_of_rows, time_groups
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

Array = NDArray[np.float64]

MOST_IN_VAIN = 5
"""Sets that are fitted one after the other without one that is better."""

STEADY = 0.2
"""Share of its mean by which an effect's size may follow a structure (rms) and still be called that effect."""

MOST_NOISE = 0.5
"""Share of what would show an effect that may be noise of the logs: with more, a fit makes more of noise than of motion."""

MOST_RIVALS = 3
"""Other effects that are fitted in the place of one."""

MOST_ROUNDS = 8
MOST_WEIGHINGS = 3
SETTLED = 0.3
"""The weights of the channels are taken anew until none changes by more than this on the scale of the logarithm."""


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """The most probable set of effects."""

    named: Fitted
    """As a robot file holds it: without structures, surrogates and trifles."""

    best: Fitted
    """The most probable set of all, as it was fitted: with them."""

    fits: tuple[Fitted, ...]
    """Every set that was fitted, the most probable first."""

    without: dict[str, Fitted]
    """The named set without each of its effects."""

    adds: dict[str, float]
    """Log odds of each other effect on top of the best set, in the model that is linear about it, as far as flights agree."""

    hidden: tuple[str, ...]
    """Effects of which these flights show no parameter."""

    drowned: tuple[str, ...]
    """Effects that they show less than noise of the logs does."""

    surrogates: dict[str, str]
    """Effects that only stand in for what remains, and what their size follows."""

    immaterial: dict[str, dict[str, Rise]]
    """Effects that were probable and are worth a trifle in each channel: the rise of its residual without them."""

    refused: dict[str, str]
    """Effects that were probable if noise were all, and why they are not named."""

    weights: Weighting

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the named effects."""
        return self.named.effects

    @property
    def holding(self) -> list[Fitted]:
        """Return the fitted sets that hold, the most probable first."""
        return [fitted for fitted in self.fits if fitted.holds]

    @property
    def structures(self) -> tuple[str, ...]:
        """Return what remains and no effect has, by kind and channel."""
        return tuple(structure.name for structure in self.best.structures)

    @property
    def sets(self) -> dict[tuple[str, ...], float]:
        """Return the probability of each set of effects, the most probable first, whatever the structure beside them.

        A wider case of an effect of the most probable set counts for that effect: beside it, it is what is meant.
        """
        meant = {wide: name for name in self.best.effects for wide in EFFECTS if name in EFFECTS.get(wide).contains}
        fits = [replace(one, effects=tuple(meant.get(name, name) for name in one.effects)) for one in self.holding]
        return probabilities_of(fits, overdispersion=self.best.overdispersion)

    @property
    def inclusion(self) -> dict[str, float]:
        """Return the probability of each effect: that of all sets that hold it."""
        return inclusion_in(self.sets)


def choose_effects(
    predictor: Predictor,
    declared: ModelParams,
    names: Sequence[str],
    *,
    material: float,
    progress: Progress = silent,
) -> Chosen:
    """Return the set of effects that is most probable given the training flights.

    Args:
        predictor: Training flights.
        declared: The declared model.
        names: Effects that these flights can show.
        material: Least relative rise of a residual (rms) without an effect that is named.
        progress: Told what is being done.
    """
    return _Chooser(predictor, declared, names, material, progress).run()


@dataclass(frozen=True, kw_only=True)
class _View:
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
        """Return the best of those without structures."""
        bare = (fitted for fitted in self.fits.values() if fitted.holds and not fitted.structures)
        return max(bare, key=lambda one: one.log_posterior)

    def known(self, label: Label) -> bool:
        """Return whether a set was fitted with the tolerances linear about the present model or about itself.

        Evidences with the tolerances linear about models that are far apart are not comparable.
        """
        return label in self.fresh or label in self.own

    def fit(self, model: Model) -> None:
        """Fit a set that is not known, from the best of its starts."""
        if not self.known(label_in(self.library, model)):
            self.add(self.fitter.fit_of(self.library, self.sets, model, self.structures))

    def add(self, fitted: Fitted) -> None:
        """Take a fitted set, and as long as it does not hold, the same without the effect for which the least speaks."""
        while not self.known(fitted.label):
            self.fits[fitted.label] = fitted
            self.fresh.add(fitted.label)
            if not fitted.holds:
                fitted = self.fitter.without_weakest(fitted)

    def settle(self, fitted: Fitted, fitter: Fitter) -> None:
        """Take a set fitted about itself, and where it does not hold, the same without what does not, fitted as any other."""
        self.own[fitted.label], self.fits[fitted.label] = fitter, fitted
        if not fitted.holds:
            self.add(self.fitter.without_weakest(fitted))


class _Chooser:
    """Holds what the rounds share."""

    def __init__(
        self,
        predictor: Predictor,
        declared: ModelParams,
        names: Sequence[str],
        material: float,
        progress: Progress,
    ) -> None:
        self.predictor, self.declared, self.names, self.material = predictor, declared, tuple(names), material
        self.skipped = tuple(name for name in EFFECTS if name not in names)
        self.progress = progress
        self.missed = predictor.residuals(declared)

    def run(self) -> Chosen:
        """Choose with the weights that the best model leaves, until these no longer change."""
        params, effects, structures = self.declared, (), ()
        weights = self.weigh(params)
        tolerance = tolerance_jacobian(self.predictor, params, self.predictor.predict(params))
        shares = noise_shares(self.predictor, params, self.names, tolerance, weights.weight)
        self.drowned = tuple(name for name, share in shares.items() if share > MOST_NOISE)
        self.names = tuple(name for name in self.names if name not in self.drowned)
        self.skipped += self.drowned
        for _ in range(MOST_WEIGHINGS):
            view = self.climb(params, effects, structures, weights)
            params, effects, structures = view.present.params, view.present.effects, view.present.structures
            before, weights = weights, self.weigh(params)
            if np.all(np.abs(np.log(weights.weight / before.weight)) < SETTLED):
                break
        return self.chosen(view)

    def weigh(self, params: ModelParams) -> Weighting:
        """Return the weights of the channels from what all effects and structures together leave over."""
        common = tuple(name for name in self.names if not has_starts(name, self.predictor.robot))
        several = [name for name in self.names if name not in common and name not in params.effects]
        tolerance = tolerance_jacobian(self.predictor, params, self.predictor.predict(params))
        flights, times, channels = self.predictor.flights, self.predictor.times, self.predictor.channels

        def beyond(residuals: list[Array], weights: Weighting) -> list[Array]:
            structures = structures_of(flights, times, channels, self.missed, residuals, {})
            return beyond_structures(structures, residuals, weights)

        columns = columns_of_starts(self.predictor, params, self.declared, several, tolerance)
        return weighting(self.predictor, params, common, columns, beyond=beyond)

    def climb(
        self, params: ModelParams, effects: tuple[str, ...], structures: tuple[Nuisance, ...], weights: Weighting
    ) -> _View:
        """Return the best set that fits lead to from a present one, with all candidates about it."""
        own: dict[Label, Fitter] = {}
        start = self.fitter_about(params, weights)
        present, nothing = start.fit(effects, structures, params), start.fit((), (), self.declared)
        fits = {nothing.label: nothing, present.label: present}
        own[present.label] = start
        for count in range(MOST_ROUNDS):
            self.progress(f"sets of effects, round {count + 1}", count / MOST_ROUNDS)
            view = self.look_around(present, own, fits)
            for more in (self.fit_probable, self.fit_fewer, self.fit_rivals):
                settled = -1
                while settled != len(own) and self.leader(view) is present:  # else what looked best was not
                    settled = len(own)
                    more(view)
                    self.leader(view)
            if (leader := self.leader(view)) is present:
                return view
            present = leader
        return self.look_around(present, own, fits)

    def fitter_about(self, params: ModelParams, weights: Weighting) -> Fitter:
        """Return what fits sets with the tolerances linear about a model."""
        return Fitter(self.predictor, self.declared, len(self.names), weights, params)

    def leader(self, view: _View) -> Fitted:
        """Return the best fitted set, each that comes first fitted once more with the tolerances linear about itself."""
        while (best := view.best).label not in view.own:
            fitter = self.fitter_about(best.params, view.fitter.weights)
            view.settle(fitter.fit(best.effects, best.structures, best.params), fitter)
        return best

    def fit_probable(self, view: _View) -> None:
        """Fit the sets that are probable about a model.

        A fit takes from a set what its linear model promised too much. So sets are fitted in the order of what they promise,
        until none promises more than the best one holds, or several in a row have not held it. Several structures together
        can make what an effect with a memory or a range makes, better than the effect where it is linear: sets without
        structures have their own turn.
        """
        values, structures = view.sets.log_posterior, view.sets.candidates.structures
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

    def fit_fewer(self, view: _View) -> None:
        """Fit the sets with an effect less than the present one, and with a narrower case of an effect."""
        for gone in (k for k in view.here if not view.library.candidates[k].structure):
            view.fit(tuple(k for k in view.here if k != gone))
        for fitted in view.fitter.narrower(view.present, self.names):
            view.add(fitted)

    def fit_rivals(self, view: _View) -> None:
        """Fit the best sets with another effect in the place of one of the present: the best, and what may be as probable."""
        candidates, least = view.library.candidates, view.present.log_posterior - reach_of(view.present)
        others = [k for k, one in enumerate(candidates) if not one.structure and one.name not in view.present.effects]
        for gone in (k for k in view.here if not candidates[k].structure):
            swaps = [tuple(sorted((*(k for k in view.here if k != gone), other))) for other in others]
            values = dict(zip(swaps, view.sets.look(swaps).tolist(), strict=True))
            for place, model in enumerate(sorted(swaps, key=values.__getitem__, reverse=True)[:MOST_RIVALS]):
                if np.isfinite(values[model]) and (place == 0 or values[model] > least):
                    view.fit(model)

    def look_around(self, present: Fitted, own: dict[Label, Fitter], fits: dict[Label, Fitted]) -> _View:
        """Return all candidates about a model, the posterior over their sets, and the structures among them."""
        flights, times, channels = self.predictor.flights, self.predictor.times, self.predictor.channels
        structures: list[Nuisance] = []

        def of_residuals(residuals: list[Array], effects: dict[str, list[Array]]) -> list[Nuisance]:
            structures.extend(structures_of(flights, times, channels, self.missed, residuals, effects))
            return structures

        library = build_library(
            self.predictor,
            self.declared,
            present.params,
            present.effects,
            skipped=self.skipped,
            structures=of_residuals,
            length=part_length(times),
        )
        fitter = own[present.label]
        normal = normal_of(library, fitter.weights)
        here = place_of(library, present)
        sets = search(candidates_of(library), normal, starts=[here])
        fits[present.label] = present
        return _View(
            present=present,
            fits=fits,
            own=own,
            fresh=set(),
            fitter=fitter,
            library=library,
            structures=structures,
            sets=sets,
            guard=Guard(library, sets, fitter.weights),
        )

    def chosen(self, view: _View) -> Chosen:
        """Return the result about the last model."""
        present = narrowest(view.present, view.fits.values(), reach_of(view.present))
        known = (fitted for label, fitted in view.fits.items() if view.known(label))
        fits = sorted(known, key=lambda one: -one.log_posterior)
        surrogates = self.varying(present, view.fitter)
        named, ends = view.fitter.in_file(self.bare(present, surrogates, view))
        named, immaterial, without = self.without_trifles(named, view.fitter)
        refused = {
            name: f"probable if noise were all (log odds {found.log_odds:.0f}), not as far as flights agree on it, or only "
            "beside a structure"
            for name, found in (present.support if fits[0].holds else fits[0].support | present.support).items()
        } | {name: f"runs into its physical bound: {', '.join(found)}" for name, found in ends.items()}
        away = (*named.effects, *surrogates, *immaterial)
        shown = {candidate.name for candidate in seen_candidates(view.library, view.fitter.weights.weight)}
        return Chosen(
            named=named,
            best=present,
            fits=tuple(fits),
            without=without,
            adds=self.adds(view),
            hidden=tuple(name for name in self.names if name not in shown),
            drowned=self.drowned,
            surrogates=surrogates,
            immaterial=immaterial,
            refused={name: reason for name, reason in refused.items() if name not in away},
            weights=view.fitter.weights,
        )

    def bare(self, present: Fitted, gone: Collection[str], view: _View) -> Fitted:
        """Return the best set without structures that holds only present effects, none of ``gone``, and that holds."""
        kept = set(present.effects).difference(gone)
        whole = (
            view.fitter.without(replace(present, structures=()), tuple(gone)) if present.structures or gone else present
        )
        fits = [one for one in view.fits.values() if one.holds and not one.structures and kept.issuperset(one.effects)]
        return max([view.fitter.held(whole), *fits], key=lambda one: one.log_posterior)

    def adds(self, view: _View) -> dict[str, float]:
        """Return what speaks for each other effect on top of the present set, best of its starts."""
        found: dict[str, float] = {}
        for k, candidate in enumerate(view.library.candidates):
            if candidate.structure or candidate.name in view.present.effects:
                continue
            model = tuple(sorted((*view.here, k)))
            if np.isfinite(view.sets.look([model])[0]):
                odds = view.guard.of(model)[k].robust_log_odds
                found[candidate.name] = max(odds, found.get(candidate.name, -np.inf))
        return found

    def without_trifles(
        self, fitted: Fitted, fitter: Fitter
    ) -> tuple[Fitted, dict[str, dict[str, Rise]], dict[str, Fitted]]:
        """Return a set without the effects that are shown to be worth less than what is material, the least one first.

        With the rise of the residuals without each, and with the set without each of those that stay.
        """
        found: dict[str, dict[str, Rise]] = {}
        group, flight = time_groups(self.predictor.times), flight_of_rows(self.predictor.times)
        names = [channel.name for channel in self.predictor.channels]
        while True:
            residual = np.concatenate(self.predictor.residuals(fitted.params))
            without = {name: fitter.without(fitted, (name,)) for name in fitted.effects}
            rises = {
                name: rise_with_interval(np.concatenate(self.predictor.residuals(less.params)), residual, group, flight)
                for name, less in without.items()
            }
            most = {name: max(rise.high for rise in of_channels) for name, of_channels in rises.items()}
            least = min(most, key=most.__getitem__, default=None)
            if least is None or most[least] >= self.material:
                return fitted, found, without
            found[least], fitted = dict(zip(names, rises[least], strict=True)), without[least]

    def varying(self, present: Fitted, fitter: Fitter) -> dict[str, str]:
        """Return the effects whose size follows a structure that remains, and what it follows: they only stand in for it.

        Never an effect that by its nature follows the same: its law may be off, but its name is right.
        """
        predictor, found = self.predictor, {}
        predicted = predictor.predict(present.params)
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        own = effect_jacobian(predictor, present.params, present.effects, predicted)
        neutral = {name: neutral_of(name, self.declared, predictor.robot) for name in present.effects}

        def log_posterior(*more: list[Array], structures: Sequence[Nuisance]) -> tuple[float, Posterior]:
            nuisance = with_structures(fitter.tolerance, structures)
            jacobians = [np.concatenate(parts, axis=2) for parts in zip(own, nuisance, *more, strict=True)]
            fit = fit_at(predictor, present.effects, present.params, residuals, jacobians, length=np.inf)
            linear = linear_about(fit, list(neutral.values()), fitter.weights, parts_of(fit.moments.flight))
            parameters = posterior(linear.candidates, linear.whole, linear.model)
            return parameters.log_evidence - len(structures) * fitter.log_names, parameters

        kinds = {structure.kind for structure in present.structures} - {"periodic"}
        for name, kind in ((name, kind) for name in present.effects for kind in sorted(kinds)):
            if kind in EFFECTS.get(name).follows or name in found:
                continue
            without = predictor.predict(present.params.with_effect(name, neutral[name]))
            functions = functions_of(kind, predictor.flights, predictor.times)
            columns = [(p - w)[..., None] * f[:, None] for p, w, f in zip(predicted, without, functions, strict=True)]
            rest = [structure for structure in present.structures if structure.kind != kind]
            steady, _ = log_posterior(structures=present.structures)
            for beside in (present.structures, rest):
                varied, parameters = log_posterior(columns, structures=beside)
                share = float(np.sqrt((parameters.step[-columns[0].shape[2] :] ** 2).sum()))
                if varied - fitter.log_names > steady and share > STEADY:
                    found[name] = kind
        return found


def reach_of(fitted: Fitted) -> float:
    """Return by how much log posterior another set may be behind one and not be told from it: odds of ``LEAST_SCORE``."""
    return LEAST_SCORE * fitted.overdispersion


def place_of(library: Library, present: Fitted) -> Model:
    """Return the set of the candidates that the present model holds."""
    beside = {structure.name for structure in present.structures}
    return tuple(
        k for k, found in enumerate(library.candidates) if found.named or (found.structure and found.name in beside)
    )
