"""How surely each effect is chosen: the selection made again on flights drawn with replacement.

A selection takes seconds, and a hundred of them minutes. This one is linear: around the final model every testable candidate
adds its derivatives, and everything after that is sums over blocks of time. The criteria are those of the selection
(``Criteria``: p-value, flights better, material, visible, harmless, noise and tolerances, bounds, the simplest of equals).
Simplified are:

- candidates are linear about the final model, those of the present model about their fitted values; their effects add up;
- every effect is free at every resample, where the selection fits the best of a first look;
- a step that leaves its bounds is held there in one more solution, not in an active-set search;
- two effects that hold only together are tried only if the selection named both.

Letters: N resamples, B blocks, F folds (flights, or quarters of a single one).
"""

from collections import Counter
from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from aerial_gym.sim2real.identify.selection.library import build_library, seen_candidates
from aerial_gym.sim2real.identify.selection.linear import LinearSelector
from aerial_gym.sim2real.identify.selection.select import Selection
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.predictor import Predictor

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

RESAMPLES = 150

FEWEST_FLIGHTS = 6
"""Of fewer flights than this, blocks of time are drawn as well, within each flight drawn."""

Item = TypeVar("Item", bound=Hashable)

LEAST_SHOWN = 0.05
"""Effects that were not named are told if they are chosen at least this often."""


@dataclass(frozen=True, kw_only=True)
class Inclusion:
    """How often effects were chosen."""

    effects: dict[str, float]
    """Share of the resamples in which each effect was chosen, the most frequent first."""

    models: dict[tuple[str, ...], float]
    """Share of the resamples that ended with each set of effects, the most frequent first."""

    resamples: int
    """N."""


def inclusion(predictor: Predictor, declared: ModelParams, selection: Selection, *, seed: int) -> Inclusion:
    """Return how often each effect is chosen when the training flights are drawn again.

    Args:
        predictor: Training flights.
        declared: The declared model.
        selection: The result whose certainty is asked for.
        seed: Same seed, same result.

    Source:
        Davison, Hinkley (1997), Bootstrap Methods and their Application, section 3.8 (hierarchical data); Sauerbrei,
        Schumacher (1992), A bootstrap resampling procedure for model building, Statistics in Medicine 11 (inclusion).
    """
    fit = selection.final.fit
    library = build_library(
        predictor, declared, fit.point, selection.accepted, frozen=fit.frozen, skipped=selection.not_testable
    )
    library = replace(library, candidates=seen_candidates(library, selection.weights.weight), tangents=[])
    draws = draw_blocks(selection.left_out.fold, np.random.default_rng(seed))
    models = LinearSelector(library, selection, draws).select()
    sets = [tuple(sorted(library.candidates[k].name for k in model)) for model in models]
    effects = Counter(name for names in sets for name in names)
    return Inclusion(effects=_shares(effects, len(sets)), models=_shares(Counter(sets), len(sets)), resamples=len(sets))


def _shares(counts: Counter[Item], total: int) -> dict[Item, float]:
    return {item: count / total for item, count in counts.most_common()}


def draw_blocks(fold: Indices, rng: np.random.Generator) -> Array:
    """Return how often each block is drawn in each resample, (N, B): whole folds, and blocks within them if folds are few.

    Each resample has two different folds at least, so that one can be left out.
    """
    labels = np.unique(fold)
    draws = np.zeros((RESAMPLES, fold.size))
    for row in draws:
        while np.unique(folds := rng.choice(labels, labels.size)).size < min(2, labels.size):
            pass
        for label in folds:
            own = np.flatnonzero(fold == label)
            np.add.at(row, rng.choice(own, own.size) if labels.size < FEWEST_FLIGHTS else own, 1.0)
    return draws
