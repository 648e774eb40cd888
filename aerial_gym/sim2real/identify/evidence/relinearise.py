"""Refits of a set of effects with the tolerances linearised about the set itself, and from other starts of its effects."""

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter

import numpy as np

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.candidates.library import has_several_starts, is_of_one_rotor
from aerial_gym.sim2real.identify.evidence.fitting import EffectSetFit, Fitter
from aerial_gym.sim2real.identify.least_squares.gauss_newton import CONVERGENCE, StopRule

SAME_DEVIATION = 0.5  # Largest change of a deviation, in standard deviations, that ends relinearisation
MOST_TURNS = 4  # Largest number of relinearisations of a set; a sensor delay of two standard deviations needs three


def refit_with_own_tolerances(
    fitted: EffectSetFit, about: Fitter, fitter_at_model: Callable[..., Fitter], *,
    best: float, window: float, rule: StopRule = CONVERGENCE,
) -> tuple[EffectSetFit, Fitter]:  # fmt: skip
    """Return a set refitted, with tolerances linearised about itself until its deviations settle, and its fitter.

    Secants correct the derivatives at first, by fits with a stopping ``rule``. Derivatives are computed anew for a set that
    can reach the rule's least log posterior, until it cannot come within ``window`` of the ``best`` one.
    """
    settings = {"least": rule.least, "rule": replace(rule, least=-np.inf)}
    fitted, about, reached = refit_until_settled(fitted, about, fitter_at_model, secant=True, **settings)
    return refit_until_settled(fitted, about, fitter_at_model, least=best - window)[:2] if reached else (fitted, about)


def refit_until_settled(
    fitted: EffectSetFit, about: Fitter, fitter_at_model: Callable[..., Fitter], *,
    least: float = -np.inf, secant: bool = False, rule: StopRule = CONVERGENCE,
) -> tuple[EffectSetFit, Fitter, bool]:  # fmt: skip
    """Return a set refitted until its deviations settle, its fitter, and whether it can reach the log posterior ``least``.

    A delay of 6 ms is fitted only in part about a model without one. If deviations do not settle, the most probable turn is
    kept. It ends if the log posterior stays below ``least`` even with the last gain once more, as gains become smaller.
    ``secant``: secants correct the derivatives by the tolerances, which costs two predictions; else they are computed anew.
    ``rule``: stopping rule of each fit.
    """
    first, last, kept = about, np.inf, (fitted, about, True)
    for _ in range(MOST_TURNS):
        about.clear_nuisance_sums()
        fitter = fitter_at_model(fitted.model_with_deviations, about.weights)
        fitter.tolerances = about.secant_tolerances(fitted) if secant else None
        if about is not first:
            about.tolerances = None  # large; only a divergent iteration needs them again
        again = fitter.refit_from_other_fitter(fitted, about, rule)
        if not again.deviation.size:  # the fit made no step
            return again, fitter, False
        moved = float(np.abs(again.deviation - fitted.deviation).max())
        if moved > last:
            break
        gain = max(0.0, again.log_posterior - fitted.log_posterior)
        fitted, about, last, reached = again, fitter, moved, again.log_posterior + gain >= least
        if kept[1] is first or moved < SAME_DEVIATION or fitted.log_posterior >= kept[0].log_posterior:
            kept = fitted, about, reached
        if moved < SAME_DEVIATION or not reached:
            break
    return kept


def refit_from_starts(fitted: EffectSetFit, fitter: Fitter) -> EffectSetFit:
    """Return the most probable fit of a set over the starts of its effects: those with several have local optima."""
    best, robot = fitted, fitter.predictor.robot
    for name in fitted.effects:
        if is_of_one_rotor(name) or name in fitter.declared.effects or not has_several_starts(name, robot):
            continue
        for start in EFFECTS.get(name).starts(robot):
            params, rule = best.params.with_effect(name, np.array(start)), StopRule(least=best.log_posterior)
            refitted = fitter.fit(best.effects, best.structures, params, rule=rule)
            best = max(best, refitted, key=attrgetter("log_posterior"))
    return best
