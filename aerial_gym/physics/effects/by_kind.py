"""Effects with their parameters, sorted by kind.

Letters: E environments, P parameters of an effect.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from torch import Tensor

from aerial_gym.physics.effects.base import (
    CommandEffect,
    DelayEffect,
    Effect,
    FluidEffect,
    LoadEffect,
    RotorEffect,
    WindEffect,
    WrenchEffect,
)
from aerial_gym.physics.effects.on_links import LinkEffect, LinkFluidEffect, LinkWrenchEffect

EffectParams = tuple[Effect, Tensor]
"""An effect and its parameters, (E, P)."""

STEP_KINDS: tuple[type[Effect], ...] = (
    WindEffect,
    RotorEffect,
    WrenchEffect,
    FluidEffect,
    LinkWrenchEffect,
    LinkFluidEffect,
    LinkEffect,
    CommandEffect,
    DelayEffect,
    LoadEffect,
)
"""Kinds that act in every step, in the order of parameters and memory; a load comes last, as its memory moves with the body."""

Kind = TypeVar("Kind", bound=Effect)


@dataclass(frozen=True)
class Place:
    """Where the numbers of one effect stand among those of all that act in a step."""

    effect: Effect
    params: slice
    """Among all parameters."""

    memory: slice
    """Among all remembered numbers."""


class EffectsByKind:
    """Effects with their parameters; ``effects[WindEffect]`` are those of a kind, in the order in which they were given."""

    def __init__(self, effects: Iterable[EffectParams] = ()) -> None:
        """Take effects with their parameters (E, P), or with what they remember behind them, (E, P + M)."""
        self._all = tuple(effects)
        self._of: dict[type[Effect], tuple[EffectParams, ...]] = {}
        for effect, params in self._all:
            self._of[effect.kind] = (*self._of.get(effect.kind, ()), (effect, params))

    def __iter__(self) -> Iterator[EffectParams]:
        """Yield all of them as they were given."""
        return iter(self._all)

    def __getitem__(self, kind: type[Kind]) -> tuple[tuple[Kind, Tensor], ...]:
        """Return the effects of a kind."""
        return self._of.get(kind, ())  # pyright: ignore[reportReturnType]

    @property
    def forces(self) -> tuple[EffectParams, ...]:
        """Effects that act in every step, in the order of ``STEP_KINDS``."""
        return tuple(one for kind in STEP_KINDS for one in self[kind])

    def places(self, num_rotors: int) -> list[Place]:
        """Return where parameters and memory of each of ``forces`` stand, for a number of rotors R."""
        found, params, memory = [], 0, 0
        for effect, _ in self.forces:
            width, remembered = len(effect.parameters), len(effect.fresh_memory(num_rotors))
            found.append(Place(effect, slice(params, params + width), slice(memory, memory + remembered)))
            params, memory = params + width, memory + remembered
        return found

    @property
    def remembering(self) -> tuple[str, ...]:
        """Names of the effects with memory of their own."""
        return tuple(effect.name for effect, _ in self.forces if effect.remembers)

    def plus(self, effect: Effect, params: Tensor) -> "EffectsByKind":
        """Return these and one more."""
        return EffectsByKind((*self._all, (effect, params)))

    def without(self, *kinds: type[Effect]) -> "EffectsByKind":
        """Return these but the ones of some kinds."""
        return EffectsByKind(one for one in self._all if one[0].kind not in kinds)

    def where(self, chosen: Callable[[Effect], bool]) -> "EffectsByKind":
        """Return those that are chosen."""
        return EffectsByKind(one for one in self._all if chosen(one[0]))

    def with_params(self, change: Callable[[Effect, Tensor], Tensor]) -> "EffectsByKind":
        """Return them with ``change(effect, params)`` in place of each one's parameters."""
        return EffectsByKind((effect, change(effect, params)) for effect, params in self._all)
