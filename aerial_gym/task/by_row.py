"""What a task computes row by row, as few launches: torch functions traced into Warp kernels, and what cannot be traced apart.

Letters: E environments.
"""

import logging
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar, cast

import torch
from torch import Tensor

from aerial_gym.interop.rows import RowFunction, UntraceableError, trace
from aerial_gym.math.rows import on_whole_vectors
from aerial_gym.task.observations import ObservationTerm, TaskState

_log = logging.getLogger(__name__)
Result = TypeVar("Result", Tensor, tuple[Tensor, ...])


class ByRow(Generic[Result]):
    """A pure function of tensors of rows as one kernel, traced at its first call; as torch operations where that fails."""

    def __init__(self, function: Callable[..., Result], what: str) -> None:
        """Take the function and what a warning calls it."""
        self._function, self._what = function, what
        self._rows: RowFunction | None = None
        self._single = True
        self.reason: str | None = None
        """Why it runs as torch operations, or None."""

    def __call__(self, *tensors: Tensor, out: Sequence[Tensor] = ()) -> Result:
        """Return what the function returns; ``out`` receives the first results, also where they are inputs."""
        if self._rows is None and self.reason is None:
            self._trace(tensors)
        if self._rows is None:
            whole = on_whole_vectors(self._function, tensors[0].shape[0], tensors[0].device)(*tensors)
            for target, result in zip(out, (whole,) if isinstance(whole, Tensor) else whole, strict=False):
                target.copy_(result)
            return whole
        results = self._rows(*tensors, out=out)
        return cast("Result", results[0] if self._single else results)

    def _trace(self, tensors: Sequence[Tensor]) -> None:
        def noting(*inputs: Tensor) -> Result:
            result = self._function(*inputs)
            self._single = isinstance(result, Tensor)
            return result

        try:
            self._rows = RowFunction(noting, tensors)
        except UntraceableError as error:
            self.reason = str(error)
            _log.warning("%s runs as many small torch operations: %s", self._what, error)


def terms_apart(terms: Sequence[tuple[str, ObservationTerm]], state: TaskState) -> tuple[int, ...]:
    """Return the positions of the terms that cannot be part of one kernel: those of images, and those that do not trace.

    A term of neither kind is named in a warning.
    """
    apart = []
    for i, (name, term) in enumerate(terms):
        try:
            trace(lambda *tensors, term=term: term.value(TaskState.of(tensors)), tuple(vars(state).values()))
        except UntraceableError as error:
            apart.append(i)
            if not term.needs_image:
                _log.warning("observation term %r runs as torch operations of its own: %s", name, error)
    return tuple(apart)


def beside(terms: Sequence[ObservationTerm], state: TaskState) -> Tensor:
    """Return terms as torch computes them, side by side, (E, W)."""
    values = tuple(vars(state).values())
    whole = on_whole_vectors(
        lambda *tensors: torch.cat([term.value(TaskState.of(tensors)) for term in terms], dim=-1),
        state.position.shape[0],
        state.position.device,
    )
    return whole(*values)


def side_by_side(
    terms: Sequence[ObservationTerm], apart: Sequence[int], state: TaskState, widths: Sequence[int]
) -> Tensor:
    """Return the terms, (E, O); those ``apart`` are taken from ``state.apart``, where they stand in order."""
    given = iter(state.apart.split([widths[i] for i in apart], dim=-1) if apart else ())
    return torch.cat([next(given) if i in apart else term.value(state) for i, term in enumerate(terms)], dim=-1)
