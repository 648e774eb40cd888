"""What tells sets of effects and structures from each other."""

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from aerial_gym.physics import EFFECTS
from aerial_gym.sim2real.identify.candidates.library import Library
from aerial_gym.sim2real.identify.evidence.laplace import Model
from aerial_gym.sim2real.identify.least_squares.gauss_newton import Frozen, is_number, scales

Array = NDArray[np.float64]

Label = tuple[str, ...]
"""Names of a set's effects, with their rotor or what is free of them, and structures, sorted."""


def free_places(name: str, frozen: Frozen) -> list[int]:
    """Return the places of the parameters of an effect that a fit may change."""
    return [k for k in range(scales((name,)).size) if is_number(name, k) and (name, k) not in frozen]


def of_effects(effects: Sequence[str], frozen: Frozen) -> Frozen:
    """Return those of frozen parameters that belong to some effects."""
    return frozenset(owner for owner in frozen if owner[0] in effects)


def label_of(
    effects: Iterable[tuple[str, Array]], structures: Iterable[str] = (), frozen: Frozen = frozenset()
) -> Label:
    """Return what tells a set of effects, with a parameter vector each, and structures from others."""
    return tuple(sorted([*(_label(name, values, frozen) for name, values in effects), *structures]))


def _label(name: str, values: Array, frozen: Frozen) -> str:
    """Return an effect with its rotor, or the parameters that are free where others are frozen."""
    parameters = EFFECTS.get(name).parameters
    if parameters[0].kind == "rotor":
        return f"{name} {values[0]:.0f}"
    if not of_effects((name,), frozen):
        return name
    return " ".join([name, *(parameters[k].name for k in free_places(name, frozen))])


def label_in(library: Library, model: Model) -> Label:
    """Return what tells a set of a library's candidates from others."""
    chosen = [library.candidates[k] for k in model]
    effects = [(one.name, one.start) for one in chosen if not one.structure]
    frozen = frozenset(owner for one in chosen for owner in one.frozen)
    return label_of(effects, [one.name for one in chosen if one.structure], frozen)
