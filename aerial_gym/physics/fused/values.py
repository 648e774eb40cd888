"""Parameters and memory of all effects of one environment in one vector: it stays in registers over the substeps.

First all parameters, then all memory, each in the order of ``EffectsByKind.forces``.
Letters: P parameters, M remembered numbers of an effect.
"""

from dataclasses import dataclass
from typing import Any

import warp as wp

from aerial_gym.physics.effects import STEP_KINDS, Effect, LoadEffect
from aerial_gym.physics.fused.types import vector_of
from aerial_gym.physics.model import Model


@dataclass(frozen=True)
class Pick:
    """Access to what belongs to one effect."""

    get: wp.Function
    """``wp.func`` (values of all effects) -> parameters of this one, and its memory behind them: vector of P + M."""

    put: wp.Function
    """``wp.func`` (values of all, vector of P + M) -> values of all with this memory."""


def num_values(model: Model) -> tuple[int, int]:
    """Return how many parameters and remembered numbers there are."""
    memory = sum(len(effect.fresh_memory(model.vehicle.num_rotors)) for effect, _ in model.effects.forces)
    return sum(p.shape[1] for _, p in model.effects.forces), memory


def values_type(model: Model) -> Any:
    """Return the type of the vector."""
    return vector_of(max(sum(num_values(model)), 1))


def pickers(model: Model) -> dict[type[Effect], list[Pick]]:
    """Return access to each effect of each kind. A load keeps its memory with the motion, and is given parameters alone."""
    found, first, (first_memory, _) = {}, 0, num_values(model)
    for kind in STEP_KINDS:
        found[kind] = []
        for effect, params in model.effects[kind]:
            width, memory = params.shape[1], len(effect.fresh_memory(model.vehicle.num_rotors))
            shown = 0 if kind is LoadEffect else memory
            found[kind].append(_pick(values_type(model), first, width, first_memory, shown))
            first, first_memory = first + width, first_memory + memory
    return found


def _pick(values: Any, first: int, width: int, first_memory: int, memory: int) -> Pick:
    own = vector_of(width + memory)

    @wp.func
    def get(all_values: values) -> own:
        picked = own()
        for i in range(wp.static(width)):
            picked[i] = all_values[wp.static(first) + i]
        for i in range(wp.static(memory)):
            picked[wp.static(width) + i] = all_values[wp.static(first_memory) + i]
        return picked

    @wp.func
    def put(all_values: values, own_values: own) -> values:
        after = all_values
        for i in range(wp.static(memory)):
            after[wp.static(first_memory) + i] = own_values[wp.static(width) + i]
        return after

    return Pick(get, put)
