"""Effects with their parameters, selected by kind.

Letters: E environments, P parameters of an effect.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor

from aerial_gym.physics.effects.base import Effect

EffectParams = tuple[Effect, Tensor]  # An effect and its parameters, (E, P)
Kind = TypeVar("Kind", bound=Effect)


@dataclass(frozen=True)
class EffectPlace:
    """Position of the numbers of one effect among those of all effects of a step."""

    effect: Effect
    params: slice  # Among all parameters
    memory: slice  # Among all remembered numbers


class EffectsByKind:
    """Effects with their parameters; ``effects[WindEffect]`` are those of a kind, in the given order."""

    def __init__(self, effects: Iterable[EffectParams] = ()) -> None:
        """Take effects with their parameters (E, P), or with their memory behind them, (E, P + M)."""
        self._all = tuple(effects)
        ranked = ((effect.order, index) for index, (effect, _) in enumerate(self._all) if effect.order is not None)
        self.step_order = tuple(index for _, index in sorted(ranked))
        """Indices of the effects of a step, by ``Effect.order``."""
        self._of: dict[type[Effect], tuple[EffectParams, ...]] = {}

    def __iter__(self) -> Iterator[EffectParams]:
        """Yield all effects in the given order."""
        return iter(self._all)

    def __getitem__(self, kind: type[Kind]) -> tuple[tuple[Kind, Tensor], ...]:
        """Return the effects of a kind."""
        if kind not in self._of:
            self._of[kind] = tuple(one for one in self._all if isinstance(one[0], kind))
        return self._of[kind]  # pyright: ignore[reportReturnType]

    @property
    def step_effects(self) -> tuple[EffectParams, ...]:
        """Effects of a step, in ``step_order``."""
        return tuple(self._all[index] for index in self.step_order)

    def places(self, num_rotors: int) -> list[EffectPlace]:
        """Return the places of parameters and memory of each of ``forces``, for a number of rotors R."""
        places, params, memory = [], 0, 0
        for effect, _ in self.step_effects:
            width, remembered = len(effect.parameters), len(effect.fresh_memory(num_rotors))
            places.append(EffectPlace(effect, slice(params, params + width), slice(memory, memory + remembered)))
            params, memory = params + width, memory + remembered
        return places

    @property
    def names_with_memory(self) -> tuple[str, ...]:
        """Names of the effects with memory of their own."""
        return tuple(effect.name for effect, _ in self.step_effects if effect.remembers)

    def with_effect(self, effect: Effect, params: Tensor) -> "EffectsByKind":
        """Return these effects and one more."""
        return EffectsByKind((*self._all, (effect, params)))

    def exclude(self, *kinds: type[Effect]) -> "EffectsByKind":
        """Return all effects except those of some kinds."""
        return EffectsByKind(one for one in self._all if not isinstance(one[0], kinds))

    def select(self, chosen: Callable[[Effect], bool]) -> "EffectsByKind":
        """Return the effects for which ``chosen`` is true."""
        return EffectsByKind(one for one in self._all if chosen(one[0]))

    def with_params(self, change: Callable[[Effect, Tensor], Tensor]) -> "EffectsByKind":
        """Return the effects with ``change(effect, params)`` as their parameters."""
        return EffectsByKind((effect, change(effect, params)) for effect, params in self._all)

    def with_memory(self, numbers: Iterable[Tensor]) -> "EffectsByKind":
        """Return the effects with remembered numbers (E, M), in ``step_order``, behind their parameters.

        Memory that ``moves_with_body`` is part of the state, so these effects keep their parameters alone.
        """
        effects = list(self._all)
        for index, own in zip(self.step_order, numbers, strict=True):
            effect, params = effects[index]
            if not effect.moves_with_body:
                effects[index] = effect, torch.cat((params, own), dim=-1)
        return EffectsByKind(effects)
