"""What effects answer for the same rows again and again, under models that differ in little.

A fit asks for many models about one. An effect is asked anew only where its parameters, or something that it has read, differ
from those for which it has answered: what it reads is noted while it answers, so that no effect has to say.
Letters: E rows, P parameters.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, cast

import torch
from torch import Tensor

from aerial_gym.physics.effects import Condition
from aerial_gym.physics.effects.track import Track
from aerial_gym.physics.vehicle import Vehicle, is_shared

KEPT = 2
"""Answers kept to each question: first the one that stood most, for the model about which others differ."""

Source = TypeVar("Source", Condition, Track)


class _Reader:
    """Stands for what an effect is told, or for the vehicle in it, and notes what is read of it."""

    def __init__(self, source: object) -> None:
        self.source, self.read = source, dict[str, Any]()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # asked for by pickle and copy, of an object without attributes yet
            raise AttributeError(name)
        value = getattr(self.source, name)
        return self.read.setdefault(name, _Reader(value) if isinstance(value, Vehicle) else value)


@dataclass(frozen=True, kw_only=True)
class _Answer:
    params: Tensor | None
    read: dict[str, Any]
    value: Tensor


class Answers(Generic[Source]):
    """Answers of effects for some rows, whose states stay the same."""

    def __init__(self) -> None:
        self._answers: dict[Hashable, list[_Answer]] = {}

    def ask(
        self, law: Callable[..., Tensor], source: Source, params: Tensor | None = None, *, place: int = 0
    ) -> Tensor:
        """Return ``law(source, params)``, an answer that stands or a new one; not to be written to.

        Args:
            params: With what it remembers behind them, (E, P). None: ``law(source)``, which has none.
            place: Tells apart sources for each of which answers are kept.
        """
        kept = self._answers.setdefault((law, place), [])
        for number, answer in enumerate(kept):
            if _same(params, answer.params) and _reads_same(answer.read, source):
                kept.insert(0, kept.pop(number))
                return answer.value
        reader = _Reader(source)
        value = law(cast("Source", reader), *(() if params is None else (params,)))
        kept.insert(1, _Answer(params=params, read=reader.read, value=value))
        del kept[KEPT:]
        return value


def _reads_same(read: dict[str, Any], source: object) -> bool:
    return all(_same(getattr(source, name), value) for name, value in read.items())


def _same(value: Any, before: Any) -> bool:
    """Return whether what would be read is what was read; no where that cannot be told, or for NaN."""
    if value is before:
        return True
    if isinstance(before, _Reader):
        return value is before.source or _reads_same(before.read, value)
    if not isinstance(value, Tensor) or not isinstance(before, Tensor):
        return isinstance(value, (float, int, frozenset)) and bool(value == before)
    if value.shape != before.shape or not value.numel() or is_shared(value) != is_shared(before):
        return False  # shared rows may be worked out in another order
    return torch.equal(value[:1], before[:1]) if is_shared(value) else torch.equal(value, before)
