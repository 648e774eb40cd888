"""Search for the most probable set of effects.

Candidates are linearised about the present set, and the posterior over sets ranks them. The most probable ones are fitted
with the full model; the best becomes the present set, until no fit is better.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import (
    Tangent,
    build_library,
    has_several_starts,
    linearise_candidates,
)
from aerial_gym.sim2real.identify.candidates.nuisance import (
    NuisanceColumns,
    Nuisances,
    limits_of_flight_offsets,
    residuals_beyond_structures,
)
from aerial_gym.sim2real.identify.evidence.fitting import (
    EffectSetFit,
    Fitter,
    Label,
    label_of_candidate_set,
    params_without_effects,
)
from aerial_gym.sim2real.identify.evidence.guard import (
    Guard,
    make_candidates,
    make_normal_equations,
    num_parts_per_flight,
)
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.evidence.relinearise import (
    SAME_DEVIATION,
    refit_from_starts,
    refit_with_own_tolerances,
)
from aerial_gym.sim2real.identify.evidence.search import search_sets
from aerial_gym.sim2real.identify.least_squares.derivative_sums import (
    SparseColumns,
    SparseDerivatives,
    join_columns,
    split_columns,
    weighted_moments,
)
from aerial_gym.sim2real.identify.least_squares.derivatives import (
    Derivatives,
    correct_derivatives,
    linear_change,
    parameter_row,
    parameter_scales,
    replace_params,
    rms_caused_by_tolerances,
    tolerance_jacobian,
)
from aerial_gym.sim2real.identify.least_squares.gauss_newton import (
    CONVERGENCE,
    UNIT,
    StopRule,
    fit_of_moments,
    least_squares_step_in_bounds,
)
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, inverse_variance_weights
from aerial_gym.sim2real.identify.selection.candidate_view import (
    CandidateView,
    Way,
    candidates_of_fit,
    free_other_fitters,
    occam_window,
    rival_sets,
)
from aerial_gym.sim2real.identify.selection.kinematics import effects_against_kinematics
from aerial_gym.sim2real.memory import give_back_memory
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress

MOST_IN_VAIN = 5  # Largest number of consecutive fits without improvement
MOST_RIVALS = 3  # Largest number of rivals that are fitted in place of one effect

MOST_ROUNDS = 8
MOST_WEIGHINGS = 3
SETTLED = 0.3  # Channel weights are updated until no logarithm of a weight changes by more than this


class SetSearch:
    """Local search over sets of effects, from the present set to a better one until none is found."""

    view: CandidateView  # Candidates about the present set; large, so the previous ones are freed first
    _weighed: tuple[ModelParams, Weighting]  # The last model whose channel weights were computed, with these weights

    def __init__(self, predictor: Predictor, declared: ModelParams, names: Sequence[str], progress: Progress) -> None:
        self.predictor, self.declared, self.progress = predictor, declared, progress
        self.refused = dict[str, Finding]()  # Effects that were left out during the search, with the reason
        self.allow_effects(names)
        tolerance = tolerance_jacobian(predictor, declared)
        self.tolerated = rms_caused_by_tolerances(tolerance, predictor.robot.num_rotors)
        self._tolerance = split_columns(tolerance)
        self.missed, most = predictor.residuals(declared), limits_of_flight_offsets(predictor, self.tolerated)
        self.nuisances = Nuisances(predictor.flights, predictor.times, predictor.channels, self.missed, most)

    def allow_effects(self, names: Iterable[str]) -> None:
        """Consider these effects from now on; laws in place of others among them are no candidates by themselves."""
        self.allowed = tuple(names)
        self.names = tuple(name for name in self.allowed if not EFFECTS.get(name).in_place)
        self.skipped = tuple(name for name in EFFECTS if name not in self.names)

    def refuse_effects(self, reasons: Mapping[str, Finding]) -> None:
        """Consider some effects no longer."""
        self.refused |= reasons
        self.allow_effects(name for name in self.allowed if name not in reasons)

    def find_best_set(self, last: CandidateView | None = None) -> CandidateView:
        """Return the view after searches and new channel weights in turn, from the declared model or the ``last`` view."""
        likely = (self.fit_probable_sets, self.fit_smaller_sets)
        if last is None:
            self.view = self.view_of_declared_model()
        else:
            self.view = last
            self.move_to_allowed_set(last.fitter.weights)
        rivals = (self.refit_moved_sets, self.fit_rival_sets, self.fit_nearest_rivals)
        for ways in (likely, (*likely, *rivals)):
            for left in reversed(range(MOST_WEIGHINGS)):
                self.climb_to_best_set(ways)
                weights = self.residual_weights(self.view)
                change = np.log(weights.weight / self.view.fitter.weights.weight)
                if not left or np.all(np.abs(change) < SETTLED):
                    break
                self.move_to_allowed_set(weights)
        last = self.view
        last.free_memory()
        del self.view  # its strategies are methods of this object: the cycle would keep both in memory
        return last

    def move_to_allowed_set(self, weights: Weighting) -> None:
        """Move to the present set without refused effects, under new channel weights."""
        present = self.view.present
        del self.view  # large, so free it before the next one
        give_back_memory()
        effects = tuple(name for name in present.effects if name not in self.refused)
        params = params_without_effects(present.model_with_deviations, self.refused, self.declared)
        self.view = self.view_of_supported_set(params, effects, present.structures, weights)

    def view_of_declared_model(self) -> CandidateView:
        """Return the candidates about the declared model, with the channel weights from its residuals."""
        tangents = linearise_candidates(self.predictor, self.declared, self.declared, skipped=self.skipped)
        tolerance = self._tolerance
        del self._tolerance  # used only once, and large
        self._weighed = self.declared, self.channel_weights(self.declared, tangents, tolerance)
        return self.view_of_supported_set(self.declared, (), (), self._weighed[1], tangents, tolerance)

    def residual_weights(self, view: CandidateView) -> Weighting:
        """Return the channel weights from the residuals of the present model; those of the last model are cached."""
        params = view.present.params
        if params is not self._weighed[0]:
            view.fitter.clear_nuisance_sums()
            give_back_memory()
            weights = self.channel_weights(params, view.library.tangents, view.fitter.tolerance_columns())
            self._weighed = params, weights
        return self._weighed[1]

    def channel_weights(self, params: ModelParams, tangents: Sequence[Tangent], tolerance: SparseColumns) -> Weighting:
        """Return the channel weights from the residual after a fit of all effects and structures together."""
        several = [one for one in tangents if has_several_starts(one.name, self.predictor.robot)]
        common = [one for one in tangents if not has_several_starts(one.name, self.predictor.robot)]
        start = params
        for one in common:
            start = start.with_effect(one.name, one.start)

        channels = len(self.predictor.channels)
        new = [one for one in several if one.name not in params.effects]
        linear = [join_columns(tolerance, channels), *(one.dense_derivatives(channels) for one in new)]
        empty = [np.empty((*residual.shape, 0), dtype=np.float32) for residual in self.missed]
        whole = [one.dense_derivatives(channels) for one in common]
        own = [np.concatenate(parts, axis=2) for parts in zip(empty, *whole, strict=True)]
        del whole
        return self._channel_weights_after_fits(start, tuple(one.name for one in common), own, linear)

    def _channel_weights_after_fits(
        self, params: ModelParams, effects: tuple[str, ...], own: Sequence[Array], linear: Sequence[Derivatives]
    ) -> Weighting:
        """Return the channel weights after three joint fits, each with weights from the last residual beyond structures.

        ``own``: derivatives by the effects, (rows, C, P), updated in place. ``linear``: further columns, (rows, C, any).
        """
        predictor = self.predictor
        predicted = predictor.predict(params)
        weights = inverse_variance_weights([m - p for m, p in zip(predictor.measured, predicted, strict=True)])
        ends = np.cumsum([0, *(part[0].shape[2] for part in linear)])[:-1]
        for _ in range(3):
            left = residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
            flights = list(zip(own, *linear, strict=True))
            moments = weighted_moments(predictor.times, residuals, flights, weights.weight)
            give_back_memory()
            fit = fit_of_moments(predictor.robot, effects, params, moments)
            step, *steps = np.split(
                least_squares_step_in_bounds(fit, UNIT, fit.indices_of_fitted_params), fit.num_effect_params + ends
            )
            for part, along in zip((own, *linear), (step, *steps), strict=True):
                left = [r - linear_change(columns, along) for r, columns in zip(left, part, strict=True)]
            if not all(np.isfinite(part).all() for part in left):
                break  # step beyond a pendulum's range: keep the previous weights
            structures = self.nuisances.structures_beyond_effects(left, {})
            weights = inverse_variance_weights(residuals_beyond_structures(structures, left, weights))
            here = parameter_row(params, effects)
            params = replace_params(predictor.robot, params, effects, here + parameter_scales(effects) * step)
            before, predicted = predicted, predictor.predict(params)
            predictor.clear_caches()  # of a model with all effects
            correct_derivatives(own, step, [p - b for p, b in zip(predicted, before, strict=True)])
        return weights

    def view_of_supported_set(
        self,
        params: ModelParams,
        effects: tuple[str, ...],
        structures: tuple[NuisanceColumns, ...],
        weights: Weighting,
        tangents: list[Tangent] | None = None,
        tolerance: SparseColumns | None = None,
    ) -> CandidateView:
        """Return the candidates about a set, after removal of the effects without support under these weights."""
        fitter, start = self.fitter_at_model(params, weights), replace(params, deviation=None)
        fitter.tolerances = tolerance
        present, empty = fitter.fit(effects, structures, start), fitter.fit((), (), self.declared)
        while not present.is_supported:
            present = fitter.refit_without_weakest(present)
        return self.make_candidate_view(present, {present.label: fitter}, {empty.label: empty}, tangents)

    def climb_to_best_set(self, ways: Sequence[Way]) -> None:
        """Move to the best set that the strategies reach, in rounds; refuse its effects that kinematic channels contradict."""
        for count in range(MOST_ROUNDS):
            self.progress(f"sets of effects, round {count + 1}", count / MOST_ROUNDS)
            present, own, fits = self.view.present, self.view.own, self.view.fits
            for more in (way for way in ways if way not in self.view.gone):
                settled = -1
                while (
                    settled != len(own) and self.best_relinearised_fit(self.view) is present
                ):  # repeat if relinearisation changed ranks
                    settled = len(own)
                    more(self.view)
                    self.best_relinearised_fit(self.view)
                self.view.gone.append(more)
            leader = self.best_relinearised_fit(self.view)
            against = effects_against_kinematics(self.view.own[leader.label], leader.params, leader.effects)
            if against:
                del present, own, fits, leader  # large, so free them before the next view
                self.refuse_effects(against)
                self.move_to_allowed_set(self.view.fitter.weights)
                self.climb_to_best_set(ways)
                return
            if leader is present:
                return
            del self.view
            give_back_memory()
            self.view = self.make_candidate_view(leader, own, fits)

    def fitter_at_model(self, params: ModelParams, weights: Weighting) -> Fitter:
        """Return a fitter of sets whose tolerances are linearised about a model."""
        return Fitter(self.predictor, self.declared, len(self.names), weights, params)

    def best_relinearised_fit(self, view: CandidateView) -> EffectSetFit:
        """Return the most probable set after each leading set is refitted with the tolerances linearised about itself."""
        while (best := view.best_fit).label not in view.own:
            free_other_fitters(view.own, view.present.label)
            best = refit_from_starts(best, view.fitter)
            view.add_relinearised_fit(*self.refit_about_own_model(best, view.fitter, view.present))
        free_other_fitters(view.own, view.present.label, best.label)
        return best

    def refit_about_own_model(
        self, fitted: EffectSetFit, about: Fitter, present: EffectSetFit, rule: StopRule = CONVERGENCE
    ) -> tuple[EffectSetFit, Fitter]:
        """Return a set relinearised about itself, as exactly as its distance to the ``present`` one asks, and its fitter."""
        limits = {"best": present.log_posterior, "window": occam_window(present)}
        return refit_with_own_tolerances(fitted, about, self.fitter_at_model, **limits, rule=rule)

    def fit_probable_sets(self, view: CandidateView) -> None:
        """Fit the sets that are probable in the linear model, in the order of their log posterior.

        Fits go on until no set promises more than the best one, or several in a row are in vain. Structures can imitate an
        effect with memory better than its linear model does, so sets without structures are fitted in a second pass.
        """
        values = view.sets.log_posterior
        structures = {k for k, one in enumerate(view.library.candidates) if one.is_common_structure}
        order = sorted(values, key=values.__getitem__, reverse=True)
        bare, seen = [model for model in order if not structures.intersection(model)], set[Label]()
        for turn, best_of_turn in ((order, lambda: view.best_fit), (bare, lambda: view.best_fit_without_structures)):
            vain, best = 0, best_of_turn()
            for model in turn:
                if vain == MOST_IN_VAIN or values[model] <= best.log_posterior:
                    break
                label = label_of_candidate_set(view.library, model)
                if label in seen or view.has_fit(label):
                    continue
                seen.add(label)
                view.fit_if_promising(view.guard.drop_unsupported(model))
                before, best = best, best_of_turn()
                vain = vain + 1 if best is before else 0

    def fit_smaller_sets(self, view: CandidateView) -> None:
        """Fit the sets with one effect less than the present one, and those with another law of an effect."""
        for gone in (k for k in view.present_set if not view.library.candidates[k].structure):
            view.fit_if_promising(tuple(k for k in view.present_set if k != gone))
        rule = view.stop_rule_of_comparison(beside=not view.present.has_no_structures_but_offsets)
        for fitted in view.fitter.fit_other_laws(view.present, self.allowed, rule):
            view.add_fit(fitted)

    def refit_moved_sets(self, view: CandidateView) -> None:
        """Refit, about itself, each set with one effect less whose deviations differ, and its parts if it lacks support.

        A tolerance in place of the effect has other derivatives there: with those of the present set it seems less probable.
        """
        effects = (k for k in view.present_set if not view.library.candidates[k].structure)
        self.refit_sets_elsewhere(view, [tuple(k for k in view.present_set if k != gone) for gone in effects])

    def refit_sets_elsewhere(self, view: CandidateView, models: Sequence[Model]) -> None:
        """Refit sets about themselves whose deviations differ, and their parts while they lack support and may come near."""
        for fitted in view.sets_elsewhere(models, SAME_DEVIATION):
            about = view.fitter
            rule = view.stop_rule_of_comparison(beside=not fitted.has_no_structures_but_offsets)
            while fitted.label not in view.own:
                free_other_fitters(view.own, view.present.label)
                fitted, about = self.refit_about_own_model(fitted, about, view.present, rule)
                view.add_relinearised_fit(fitted, about)
                if fitted.effects and not fitted.is_supported and fitted.most > rule.least:
                    fitted = about.refit_without_weakest(fitted)

    def fit_rival_sets(self, view: CandidateView) -> None:
        """Fit the best sets in which a rival replaces an effect, if they are as probable within ``occam_window``."""
        least = view.present.log_posterior - occam_window(view.present)
        for values in rival_sets(view):
            for model in sorted(values, key=values.__getitem__, reverse=True)[:MOST_RIVALS]:
                if values[model] > least:
                    view.fit_if_promising(model)

    def fit_nearest_rivals(self, view: CandidateView) -> None:
        """Fit the rivals of each present effect that the linear model does not distinguish from the best one, for reports."""
        for values in rival_sets(view):
            least = max(values.values(), default=0.0) - occam_window(view.present)
            models = [model for model in values if np.isfinite(values[model]) and values[model] >= least]
            self.refit_sets_elsewhere(view, sorted(models, key=values.__getitem__, reverse=True)[:MOST_RIVALS])

    def make_candidate_view(
        self,
        present: EffectSetFit,
        own: dict[Label, Fitter],
        fits: dict[Label, EffectSetFit],
        tangents: list[Tangent] | None = None,
    ) -> CandidateView:
        """Return the candidates about a set, with the posterior over their sets and the structures among them."""
        structures, fitter = list[NuisanceColumns](), own[present.label]
        free_other_fitters(own, present.label)

        def structures_of_residuals(
            residuals: list[Array], effects: dict[str, list[list[SparseDerivatives]]]
        ) -> list[NuisanceColumns]:
            structures.extend(self.nuisances.structures_beyond_effects(residuals, effects))
            return structures

        library = build_library(
            self.predictor,
            self.declared,
            present.params,
            present.effects,
            fitter.weights.weight,
            skipped=self.skipped,
            structures=structures_of_residuals,
            tangents=tangents,
            tolerance=fitter.tolerance_columns(),
            parts=num_parts_per_flight(len(self.predictor.times)),
        )
        sets = search_sets(
            make_candidates(library), make_normal_equations(library), starts=[candidates_of_fit(library, present)]
        )
        fits[present.label] = present
        give_back_memory()
        return CandidateView(
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
