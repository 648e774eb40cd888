"""Which effects the flights ask for: the most probable set of effects, fitted, and how probable each is.

Every effect must hold against the scatter between flights, and be worth more than a trifle.
"""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.arrays import Array
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.identify.candidates.library import neutral_of, seen_candidates
from aerial_gym.sim2real.identify.candidates.nuisance import OF_FLIGHTS, Nuisance, functions_of
from aerial_gym.sim2real.identify.evidence.fitting import Fitted, Fitter, label_of
from aerial_gym.sim2real.identify.evidence.laplace import Posterior, posterior
from aerial_gym.sim2real.identify.evidence.linear import linear_about
from aerial_gym.sim2real.identify.evidence.probabilities import inclusion_in, probabilities_of
from aerial_gym.sim2real.identify.least_squares.derivatives import effect_jacobian
from aerial_gym.sim2real.identify.least_squares.gauss_newton import fit_of_moments
from aerial_gym.sim2real.identify.least_squares.moments import Weighting, flight_of_rows, time_groups
from aerial_gym.sim2real.identify.selection.climb import Climber
from aerial_gym.sim2real.identify.selection.in_part import RivalInPart, rivals_in_part
from aerial_gym.sim2real.identify.selection.scoring import LEAST_SCORE
from aerial_gym.sim2real.identify.selection.view import View, occam_window
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.progress import Progress, silent
from aerial_gym.sim2real.statistics import Rise, rise_with_interval

STEADY = 0.2
"""Share of its mean by which an effect's size may follow a structure (rms) and still be called that effect."""


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """The most probable set of effects."""

    named: Fitted
    """As a robot file holds it: without structures (but offsets of flights beside it), surrogates and trifles."""

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

    surrogates: dict[str, str]
    """Effects that only stand in for what remains, and what their size follows."""

    immaterial: dict[str, dict[str, Rise]]
    """Effects that were probable and are worth a trifle in each channel: the rise of its residual without them."""

    refused: dict[str, Finding]
    """Effects that were probable if noise were all, with the reason why they are not named."""

    weights: Weighting

    tolerated: Array
    """Residual (rms) that the tolerances of the declared vehicle cause in each channel, (C,)."""

    in_part: tuple[RivalInPart, ...] = ()
    """What single parameters of the named effects may as well be."""

    @property
    def effects(self) -> tuple[str, ...]:
        """Return the named effects."""
        return self.named.effects

    def without_blind(self, name: str, neutral: Array) -> "Chosen":
        """Return the choice without a named effect of which the flights show no parameter.

        Nor do the sets without each of the others hold it, which are not fitted again: what it did there flights do not show.
        """
        less = {
            other: replace(
                one,
                effects=tuple(effect for effect in one.effects if effect != name),
                params=one.params.with_effect(name, neutral),
            )
            for other, one in self.without.items()
            if other != name
        }
        return replace(
            self,
            named=self.without[name],
            without=less,
            refused=self.refused | {name: Finding("parameters_unknown", name)},
            in_part=tuple(rival for rival in self.in_part if rival.effect != name),
        )

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
    climber = Climber(predictor, declared, names, progress)
    return _Chooser(climber, material).chosen(climber.run())


class _Chooser:
    """Makes the result of the most probable set."""

    def __init__(self, climber: Climber, material: float) -> None:
        self.predictor, self.declared, self.material = climber.predictor, climber.declared, material
        self.names, self.tolerated = climber.names, climber.tolerated

    def chosen(self, view: View) -> Chosen:
        """Return the result about the last model."""
        known = (fitted for label, fitted in view.fits.items() if view.known(label))
        fits = sorted(known, key=lambda one: -one.log_posterior)
        present = narrowest(view.present, fits, occam_window(view.present))
        surrogates = self.varying(present, view.fitter)
        named, ends = view.fitter.in_file(self.bare(present, surrogates, fits, view.fitter))
        named, unsure = self.told_from_nothing(named, present, view.fitter)
        named, blind = self.shown(named, view.fitter)
        named, immaterial, without = self.without_trifles(named, view.fitter)
        refused = {
            name: Finding("flights_disagree", name, {"log_odds": found.log_odds})
            for name, found in (present.support if fits[0].holds else fits[0].support | present.support).items()
        } | {name: Finding("at_bound", name, {"parameters": found}) for name, found in ends.items()}
        refused |= {
            name: Finding("not_told_from_nothing", name, {"log_odds": odds, "least_log_odds": LEAST_SCORE})
            if odds <= LEAST_SCORE
            else Finding("told_beside_another", name)
            for name, odds in unsure.items()
        }
        refused |= {name: Finding("parameters_unknown", name) for name in blind}
        away = (*named.effects, *surrogates, *immaterial)
        shown = {candidate.name for candidate in seen_candidates(view.library)}
        return Chosen(
            named=named,
            best=present,
            fits=tuple(fits),
            without=without,
            adds=self.adds(view),
            hidden=tuple(name for name in self.names if name not in shown),
            surrogates=surrogates,
            immaterial=immaterial,
            refused={name: reason for name, reason in refused.items() if name not in away},
            weights=view.fitter.weights,
            tolerated=self.tolerated,
            in_part=rivals_in_part(view.fitter, present, named.effects, self.names),
        )

    def bare(self, present: Fitted, gone: Collection[str], fits: Sequence[Fitted], fitter: Fitter) -> Fitted:
        """Return the best set without structures, but offsets of flights, of present effects, none of ``gone``, that holds."""
        kept = set(present.effects).difference(gone)
        whole = (
            fitter.without(replace(present, structures=present.own), tuple(gone))
            if gone or not present.bare
            else present
        )
        cases = [one for one in fits if one.holds and one.bare and kept.issuperset(one.effects)]
        return max([fitter.held(whole), *cases], key=lambda one: one.log_posterior)

    def told_from_nothing(self, fitted: Fitted, present: Fitted, fitter: Fitter) -> tuple[Fitted, dict[str, float]]:
        """Return what is left of a set when every effect can be told from nothing, and the log odds of what went.

        The same odds that tell two effects apart: to correct a vehicle by what is a little more probable than not is a false
        alarm in one case of three. They are those in the set, or those in the most probable one if these are more: what a
        structure explains there is scatter between flights here, and no doubt in an effect that holds here as well.
        """

        def odds_in(one: Fitted) -> dict[str, float]:
            found = {name: support.robust_log_odds for name, support in one.support.items()}
            for name in found.keys() & present.support.keys():
                if label_of([(name, one.params.effects[name])], ())[0] in present.label:  # the same rotor
                    found[name] = max(found[name], present.support[name].robust_log_odds)
            return found

        left = fitter.held(fitted, lambda one: one.holds and min(odds_in(one).values(), default=np.inf) > LEAST_SCORE)
        return left, {name: odds for name, odds in odds_in(fitted).items() if name not in left.effects}

    def shown(self, fitted: Fitted, fitter: Fitter) -> tuple[Fitted, list[str]]:
        """Return what is left of a set without effects of which flights show no parameter, and those.

        They may be probable by what is together with another one; a robot file would hold them with no effect.
        """
        left = fitter.held(fitted, lambda one: one.holds and all(found.shown for found in one.support.values()))
        return left, [name for name, found in fitted.support.items() if not found.shown and name not in left.effects]

    def adds(self, view: View) -> dict[str, float]:
        """Return what speaks for each other effect on top of the present set, best of its starts."""
        found: dict[str, float] = {}
        for k, candidate in enumerate(view.library.candidates):
            if candidate.structure or candidate.name in view.present.effects:
                continue
            model = tuple(sorted((*view.here, k)))
            if np.isfinite(view.sets.log_posterior_of([model])[0]):
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

        As far as flights agree on it, and told from an effect of one size as two effects are told apart. Never an effect that
        by its nature follows the same: its law may be off, but its name is right.
        """
        predictor, found = self.predictor, {}
        predicted = predictor.predict(present.params)
        residuals = [m - p for m, p in zip(predictor.measured, predicted, strict=True)]
        own = effect_jacobian(predictor, present.params, present.effects, predicted)
        neutral = {name: neutral_of(name, self.declared, predictor.robot) for name in present.effects}

        def log_posterior(structures: Sequence[Nuisance], more: list[Array] | None = None) -> tuple[float, Posterior]:
            moments = fitter.beside(structures, more).moments(residuals, own)
            fit = fit_of_moments(predictor.robot, present.effects, present.params, moments)
            linear = linear_about(fit, list(neutral.values()))
            parameters = posterior(linear.candidates, linear.whole, linear.model)
            return parameters.log_evidence - len(structures) * fitter.log_names, parameters

        kinds = sorted({structure.kind for structure in present.structures} - {"periodic", OF_FLIGHTS})
        functions = {kind: functions_of(kind, predictor.flights, predictor.times) for kind in kinds}
        steady = log_posterior(present.structures)[0] if kinds else 0.0
        for name, kind in ((name, kind) for name in present.effects for kind in kinds):
            if kind in EFFECTS.get(name).follows or name in found:
                continue
            without = predictor.predict(present.params.with_effect(name, neutral[name]))
            parts = zip(predicted, without, functions[kind], strict=True)
            columns = [(p - w)[..., None] * f[:, None] for p, w, f in parts]
            rest = [structure for structure in present.structures if structure.kind != kind]
            for beside in (present.structures, rest):
                varied, parameters = log_posterior(beside, columns)
                share = float(np.sqrt((parameters.step[-columns[0].shape[2] :] ** 2).sum()))
                if varied - fitter.log_names - steady > occam_window(present) and share > STEADY:
                    found[name] = kind
        return found


def narrowest(present: Fitted, fits: Iterable[Fitted], window: float) -> Fitted:
    """Return a set, or the best of those with a narrower case of one of its effects that are less than ``window`` behind.

    Where flights do not tell them apart, the narrower case is meant (``Effect.contains``). They do by what the wider one fits
    better with what it has more, not by how little was expected of what the narrower one has instead: a shear that does not
    grow has no vertical wind.
    """
    likely, fit = present.log_posterior - window, present.parameters.log_likelihood - window
    cases = [
        one
        for one in fits
        if one.holds and _narrower(one, present) and (one.log_posterior > likely or one.parameters.log_likelihood > fit)
    ]
    return max(cases, key=lambda one: one.log_posterior, default=present)


def _narrower(one: Fitted, other: Fitted) -> bool:
    new, gone = set(one.effects) - set(other.effects), set(other.effects) - set(one.effects)
    same = [structure.name for structure in one.structures] == [structure.name for structure in other.structures]
    return same and len(new) == len(gone) == 1 and new <= {case for wide in gone for case in EFFECTS.get(wide).contains}
