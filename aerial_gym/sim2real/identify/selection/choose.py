"""Choice of the named effects: the most probable set, fitted, with the inclusion probability of each effect.

Every named effect must be supported despite the scatter between flights, and must be material.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from scipy import special
from scipy.special import logsumexp

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import law_relatives, neutral_params, observable_candidates
from aerial_gym.sim2real.identify.candidates.nuisance import (
    OF_FLIGHTS,
    NuisanceColumns,
    gradient_functions,
    structure_functions,
)
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.evidence.guard import linearise_about_fit
from aerial_gym.sim2real.identify.evidence.laplace import Posterior, posterior
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian, parameter_row, parameter_scales
from aerial_gym.sim2real.identify.least_squares.gauss_newton import fit_of_moments
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, flight_of_rows, time_block_of_rows
from aerial_gym.sim2real.identify.selection.candidate_view import CandidateView, occam_window
from aerial_gym.sim2real.identify.selection.criteria import LEAST_NAMING_ODDS, Criteria
from aerial_gym.sim2real.identify.selection.kinematics import effects_against_kinematics
from aerial_gym.sim2real.identify.selection.partial_rivals import ParameterRival, rivals_of_parameters
from aerial_gym.sim2real.identify.selection.rotor_search import (
    PossibleEffect,
    RotorSearch,
    effect_odds,
    is_proven,
    odds_against_parts,
)
from aerial_gym.sim2real.identify.selection.set_search import SetSearch
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

STEADY = 0.2  # Largest rms variation of a named effect's size, relative to its mean: an error of its law


@dataclass(frozen=True, kw_only=True)
class MostProbableSet:
    """The most probable set of effects."""

    named: EffectSetFit  # For the robot file: without surrogates, immaterial effects, and structures but offsets
    best: EffectSetFit  # The most probable set of all, which may contain them
    fits: tuple[EffectSetFit, ...]  # Every set that was fitted, the most probable first
    without: dict[str, EffectSetFit]  # The named set without each of its effects
    adds: dict[str, float]  # Robust log odds of each other effect added to the best set, if linear
    hidden: tuple[str, ...]  # Effects of which these flights determine no parameter
    surrogates: dict[str, str]  # Surrogate effects, each with the structure that its size follows
    immaterial: dict[str, dict[str, Rise]]  # Probable effects, with the residuals' rise without them
    refused: dict[str, Finding]  # Effects probable by sensor noise alone, with the reason against them
    weights: Weighting
    tolerated: Array  # Residual (rms) that the tolerances of the declared vehicle cause in each channel, (C,)
    in_part: tuple[ParameterRival, ...] = ()  # Rival effects in place of single parameters of the named effects
    rotor_ties: dict[str, tuple[str, ...]] = field(default_factory=dict)  # Rivals on one rotor, by the named effect
    possible: tuple[PossibleEffect, ...] = ()  # Effects beside the named ones that flights neither prove nor exclude

    @property
    def effect_names(self) -> tuple[str, ...]:
        """Return the names of the effects."""
        return self.named.effects

    def without_undetermined_effect(self, name: str, neutral: Array, reason: Finding) -> Self:
        """Return the choice without a named effect that the flights do not determine, also in ``without``."""
        less = {
            other: replace(
                one,
                effects=tuple(effect for effect in one.effects if effect != name),
                params=one.params.with_effect(name, neutral),
            )
            for other, one in self.without.items()
            if other != name
        }
        refused = self.refused | {name: reason}
        in_part = tuple(rival for rival in self.in_part if rival.effect != name)
        return replace(self, named=self.without[name], without=less, refused=refused, in_part=in_part)

    @property
    def sets_with_support(self) -> list[EffectSetFit]:
        """Return the fitted sets whose effects are all supported, the most probable first."""
        return [fitted for fitted in self.fits if fitted.is_supported]

    @property
    def sets(self) -> dict[tuple[str, ...], float]:
        """Return the probability of each set over all structures.

        Generalisations, and other laws, of an effect of the best set count as it.
        """
        special = {case for name in self.best.effects for case in EFFECTS.get(name).contains}
        meant = {law: name for name in self.best.effects for law in law_relatives(name) if law not in special}
        fits = [
            replace(one, effects=tuple(meant.get(name, name) for name in one.effects)) for one in self.sets_with_support
        ]
        return set_probabilities(fits, overdispersion=self.best.parameter_overdispersion)

    @property
    def inclusion(self) -> dict[str, float]:
        """Return the posterior inclusion probability of each effect."""
        return inclusion_probabilities(self.sets)


def choose_effects(
    predictor: Predictor, declared: ModelParams, names: Sequence[str], *, material: float, progress: Progress = silent
) -> MostProbableSet:
    """Return the most probable set, whose effects are named if a residual (rms) rises by ``material`` without them."""
    search, view = SetSearch(predictor, declared, names, progress), None
    while True:
        view = search.find_best_set(view)
        chosen = _Chooser(search, material).make_result(view)
        hidden = [name for name in chosen.best.effects if name not in chosen.effect_names]
        against = effects_against_kinematics(view.fitter, chosen.named.params, chosen.effect_names)
        against |= effects_against_kinematics(view.fitter, chosen.best.params, hidden)
        if not against:
            return replace(chosen, refused=chosen.refused | search.refused)
        search.refuse_effects(against)


class _Chooser:
    """Derives the named effects and the reasons against others from the fitted sets."""

    def __init__(self, climber: SetSearch, material: float) -> None:
        self.predictor, self.declared, self.material = climber.predictor, climber.declared, material
        self.names, self.tolerated = climber.names, climber.tolerated

    def make_result(self, view: CandidateView) -> MostProbableSet:
        """Return the named set, and the reasons against other effects, from the last candidate view."""
        known = (fitted for label, fitted in view.fits.items() if view.has_fit(label))
        fits = sorted(known, key=lambda one: -one.log_posterior)
        present = best_special_case(view.present, fits, occam_window(view.present))
        surrogates = self.surrogate_effects(present, view.fitter)
        bare = self.best_set_without_structures(present, surrogates, fits, view.fitter)
        most = odds_against_parts(present, fits)
        named, unsure = self.drop_unproven(view.fitter.set_for_robot_file(bare), present, view.fitter, most)
        search = RotorSearch(view, frozenset(present.effects).difference(surrogates), most)
        named = search.best_set(named)
        unsure = {name: odds for name, odds in unsure.items() if name not in named.effects}
        named, blind = self.drop_unidentified(named, view.fitter)
        named, immaterial, without = self.drop_immaterial(named, view.fitter)
        possible = search.possible_additions(named) if named.effects else ()
        unsure |= {one.name: one.log_odds for one in possible if one.log_odds > 0.0 and one.name not in unsure}
        supports = present.support if fits[0].is_supported else fits[0].support | present.support
        refused = {
            name: Finding("flights_disagree", name, {"log_odds": one.log_odds}) for name, one in supports.items()
        }
        refused |= {
            name: Finding("not_told_from_nothing", name, {"log_odds": odds, "least_log_odds": LEAST_NAMING_ODDS})
            if odds <= LEAST_NAMING_ODDS
            else Finding("told_beside_another", name)
            for name, odds in unsure.items()
        }
        refused |= {name: Finding("parameters_unknown", name) for name in blind}
        away = (*named.effects, *surrogates, *immaterial)
        shown = {candidate.name for candidate in observable_candidates(view.library)}
        shown.update(law for name in present.effects for law in law_relatives(name))
        return MostProbableSet(
            named=named,
            best=present,
            fits=tuple(fits),
            without=without,
            adds=self.log_odds_of_additions(view),
            hidden=tuple(name for name in self.names if name not in shown),
            surrogates=surrogates,
            immaterial=immaterial,
            refused={name: reason for name, reason in refused.items() if name not in away},
            weights=view.fitter.weights,
            tolerated=self.tolerated,
            in_part=rivals_of_parameters(view.fitter, present, named.effects, self.names),
            rotor_ties=search.ties(named),
            possible=possible,
        )

    def best_set_without_structures(
        self, present: EffectSetFit, gone: Collection[str], fits: Sequence[EffectSetFit], fitter: Fitter
    ) -> EffectSetFit:
        """Return the best supported set of present effects without ``gone``, and without structures except flight offsets."""
        kept = set(present.effects).difference(gone)
        whole = present
        if gone or not present.has_no_structures_but_offsets:
            whole = fitter.refit_without_effects(replace(present, structures=present.flight_offsets), tuple(gone))
        cases = [one for one in fits if one.is_supported and one.has_no_structures_but_offsets]
        cases = [one for one in cases if kept.issuperset(one.effects)]
        return max([fitter.drop_unsupported(whole), *cases], key=lambda one: one.log_posterior)

    def drop_unproven(
        self, fitted: EffectSetFit, present: EffectSetFit, fitter: Fitter, most: Mapping[str, float] = {}
    ) -> tuple[EffectSetFit, dict[str, float]]:
        """Return the set of effects whose log odds exceed ``LEAST_NAMING_ODDS``, and the log odds of the removed ones."""
        left = fitter.drop_unsupported(fitted, lambda one: is_proven(one, present, most))
        return left, {
            name: odds for name, odds in effect_odds(fitted, present, most).items() if name not in left.effects
        }

    def drop_unidentified(self, fitted: EffectSetFit, fitter: Fitter) -> tuple[EffectSetFit, list[str]]:
        """Return a set without the effects of which flights determine no parameter, which would be neutral, and these."""
        left = fitter.drop_unsupported(
            fitted, lambda one: one.is_supported and all(results.shown for results in one.support.values())
        )
        blind = [name for name, one in fitted.support.items() if not one.shown]
        return left, [name for name in blind if name not in left.effects]

    def log_odds_of_additions(self, view: CandidateView) -> dict[str, float]:
        """Return the robust log odds of each other effect added to the present set, from its best start."""
        results: dict[str, float] = {}
        for k, candidate in enumerate(view.library.candidates):
            if candidate.structure or candidate.name in view.present.effects:
                continue
            model = tuple(sorted((*view.present_set, k)))
            if np.isfinite(view.sets.log_posteriors([model])[0]):
                odds = view.guard.support(model)[k].log_odds_with_overdispersion
                results[candidate.name] = max(odds, results.get(candidate.name, -np.inf))
        return results

    def drop_immaterial(
        self, fitted: EffectSetFit, fitter: Fitter
    ) -> tuple[EffectSetFit, dict[str, dict[str, Rise]], dict[str, EffectSetFit]]:
        """Return the set without immaterial effects, the residuals' rises without these, and sets without each other one."""
        results: dict[str, dict[str, Rise]] = {}
        group, flight = time_block_of_rows(self.predictor.times), flight_of_rows(self.predictor.times)
        names = [channel.name for channel in self.predictor.channels]
        while True:
            residual = np.concatenate(self.predictor.residuals(fitted.params))
            without = {name: fitter.refit_without_effects(fitted, (name,)) for name in fitted.effects}
            rises = {
                name: rise_with_interval(np.concatenate(self.predictor.residuals(less.params)), residual, group, flight)
                for name, less in without.items()
            }
            most = {name: max(rise.high for rise in of_channels) for name, of_channels in rises.items()}
            least = min(most, key=most.__getitem__, default=None)
            if least is None or most[least] >= self.material:
                return fitted, results, without
            results[least], fitted = dict(zip(names, rises[least], strict=True)), without[least]

    def surrogate_effects(self, present: EffectSetFit, fitter: Fitter) -> dict[str, str]:
        """Return the surrogate effects, each with the structure that its size follows.

        For a surrogate, one cause of varying size is more probable than a steady effect beside a separate structure of that
        kind, by ``occam_window``. An effect whose law has that quantity is no surrogate. A steady effect is one if its size
        has a significant gradient over position or time, of more than ``STEADY``.
        """
        predictor, results = self.predictor, {}
        predicted = predictor.predict(present.params)
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        own = effect_jacobian(predictor, present.params, present.effects, predicted)
        neutral = {name: neutral_params(name, self.declared, predictor.robot) for name in present.effects}

        def log_posterior(
            structures: Sequence[NuisanceColumns], more: list[Array] | None = None
        ) -> tuple[float, Posterior]:
            moments = fitter.nuisance_sums(structures, more).moments_with_effects(residuals, own)
            fit = fit_of_moments(predictor.robot, present.effects, present.params, moments)
            linear = linearise_about_fit(fit, list(neutral.values()))
            parameters = posterior(linear.candidates, linear.whole, linear.set_of_all)
            return parameters.log_evidence - len(structures) * fitter.log_prior_cost_of_effect, parameters

        kinds = sorted({structure.kind for structure in present.structures} - {"periodic", OF_FLIGHTS})
        functions = {kind: structure_functions(kind, predictor.flights, predictor.times) for kind in kinds}
        steady = log_posterior(present.structures)[0] if kinds else 0.0
        for name, kind in ((name, kind) for name in present.effects for kind in kinds):
            if kind in EFFECTS.get(name).follows or name in results:
                continue
            without = predictor.predict(present.params.with_effect(name, neutral[name]))
            parts = zip(predicted, without, functions[kind], strict=True)
            columns = [(p - w)[..., None] * f[:, None] for p, w, f in parts]
            rest = [structure for structure in present.structures if structure.kind != kind]
            varied, parameters = log_posterior(rest, columns)
            share = float(np.sqrt((parameters.step[-columns[0].shape[2] :] ** 2).sum()))
            if varied - fitter.log_prior_cost_of_effect - steady > occam_window(present) and share > STEADY:
                results[name] = kind
        steady = [name for name in present.effects if EFFECTS.get(name).steady and name not in results]
        if steady:
            before, gradients = log_posterior(present.structures)[1], gradient_functions(predictor)
        for name, kind in ((name, kind) for name in steady for kind in gradients):
            size = (parameter_row(present.params, (name,)) - neutral[name]) / parameter_scales((name,))
            along = effect_jacobian(predictor, present.params, (name,), predicted)
            parts = zip(along, gradients[kind], strict=True)
            columns = [
                np.linalg.norm(size) * (j[..., None] * g[:, None, None]).reshape(*j.shape[:2], -1) for j, g in parts
            ]
            _, parameters = log_posterior(present.structures, columns)
            count, gain = columns[0].shape[2], parameters.log_likelihood - before.log_likelihood
            share = float(np.sqrt((parameters.step[-count:] ** 2).sum()))
            if special.chdtrc(count, max(2.0 * gain, 0.0)) < Criteria().significance and share > STEADY:
                results[name] = kind
        return results


def best_special_case(present: EffectSetFit, fits: Iterable[EffectSetFit], window: float) -> EffectSetFit:
    """Return the best set with a special case of one effect; ``present`` if flights reject all.

    Special cases are those of ``Effect.contains``, and the first law of a cause for one that is fitted only in its place. One
    is rejected if behind by ``window`` in log posterior and in log likelihood, so not by the prior of an own parameter.
    """
    likely, fit = present.log_posterior - window, present.parameters.log_likelihood - window
    cases = [one for one in fits if one.is_supported and _is_special_case(one, present)]
    cases = [one for one in cases if one.log_posterior > likely or one.parameters.log_likelihood > fit]
    return max(cases, key=lambda one: one.log_posterior, default=present)


def _is_special_case(one: EffectSetFit, other: EffectSetFit) -> bool:
    new, gone = set(one.effects) - set(other.effects), set(other.effects) - set(one.effects)
    same = [structure.name for structure in one.structures] == [structure.name for structure in other.structures]
    wide = [EFFECTS.get(name) for name in gone]
    cases = {case for effect in wide for case in (*effect.contains, *([effect.cause] if effect.in_place else []))}
    return same and len(new) == len(gone) == 1 and new <= cases


def set_probabilities(fits: Iterable[EffectSetFit], *, overdispersion: float) -> dict[tuple[str, ...], float]:
    """Return the probability of each set, summed over structures, the most probable first, with overdispersion (guard.py)."""
    inclusion: dict[tuple[str, ...], float] = {}
    for fitted in fits:
        key = tuple(sorted(fitted.effects))
        inclusion[key] = float(np.logaddexp(inclusion.get(key, -np.inf), fitted.log_posterior / overdispersion))
    logs = np.array(list(inclusion.values()))
    shares = np.exp(logs - logsumexp(logs)).tolist()
    return dict(sorted(zip(inclusion, shares, strict=True), key=lambda item: -item[1]))


def inclusion_probabilities(sets: Mapping[tuple[str, ...], float]) -> dict[str, float]:
    """Return the posterior inclusion probability of each effect, the highest first."""
    inclusion: dict[str, float] = {}
    for names, probability in sets.items():
        for name in names:
            inclusion[name] = inclusion.get(name, 0.0) + probability
    return dict(sorted(inclusion.items(), key=lambda item: -item[1]))
