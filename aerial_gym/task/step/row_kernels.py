"""Row functions of a task as few launches: torch functions traced into Warp kernels, untraceable terms run separately.

A history of m values of width w is a buffer (E, m w), oldest first.
With gradients the functions run as torch operations, on tensors that are never overwritten; the Global Tensor Dictionary and
the buffers of a task have no gradients and are overwritten in every step.
Letters: E environments.
"""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar, cast

import torch
from torch import Tensor

from aerial_gym.interop.rows import DifferentiableRows, RowFunction, UntraceableError, trace
from aerial_gym.interop.rows.row_trace import LARGEST_ROW
from aerial_gym.math.rows import make_batch_invariant
from aerial_gym.physics.torch_backend import copy_tensors
from aerial_gym.robots.differentiable import DifferentiableBackend
from aerial_gym.task.terms.term import BoundTerm


@dataclass(frozen=True, kw_only=True)
class HistoryLine:
    """Delay and history length of a value."""

    longest_delay: int  # Largest delay [steps]
    history: int = 1  # Values shown side by side, oldest first

    @property
    def length(self) -> int:
        """Past values that must be kept, m."""
        return self.longest_delay + self.history - 1

    def frames_of_step(self, past: Tensor, value: Tensor, begun: Tensor | None) -> list[Tensor]:
        """Return the values of this step and the m before, oldest first, each (E, w). The line ``past`` is (E, m w), ``value``
        (E, w). Where an episode has just ``begun``, bool (E,), frames are this value."""
        kept = list(past.split(value.shape[1], dim=-1)) if self.length else []
        if begun is not None:
            kept = [torch.where(begun.unsqueeze(-1), value, old) for old in kept]
        return [*kept, value]

    def buffer_lengths(self, width: int) -> list[int]:
        """Return the number of past values per buffer, split so that each buffer is narrow enough for a kernel."""
        most = max(1, LARGEST_ROW // width)
        return [min(most, self.length - first) for first in range(0, self.length, most)]

    def read_frames(self, frames: list[Tensor], delay: Tensor | None) -> Tensor:
        """Return the value with a delay [steps], (E,), None for the largest, and its history, (E, history w)."""
        last = len(frames) - 1
        columns = []
        for k in reversed(range(self.history)):
            late = frames[last - self.longest_delay - k]
            if delay is not None:
                for steps in range(self.longest_delay):
                    late = torch.where((delay == float(steps)).unsqueeze(-1), frames[last - steps - k], late)
            columns.append(late)
        return torch.cat(columns, dim=-1) if len(columns) > 1 else columns[0]

    def next_line(self, frames: list[Tensor]) -> Tensor:
        """Return the line as the next step finds it, (E, m w)."""
        return torch.cat(frames[1:], dim=-1)


_log = logging.getLogger(__name__)
Result = TypeVar("Result", Tensor, tuple[Tensor, ...])


class RowKernel(Generic[Result]):
    """A pure row function as one kernel, traced at its first call; as torch operations if that fails."""

    def __init__(self, function: Callable[..., Result], label: str) -> None:
        self._function, self._what = function, label
        self._rows: RowFunction | None = None
        self._single = True
        self.reason: str | None = None  # Reason for running as torch operations, or None

    def __call__(self, *tensors: Tensor, out: Sequence[Tensor] = ()) -> Result:
        """Return the function's results; the first are also written into ``out``, which may be inputs."""
        if self._rows is None and self.reason is None and (reason := self.trace_kernel(tensors)):
            self.reason = reason
            _log.warning("%s runs as many small torch operations: %s", self._what, reason)
        if self._rows is None:
            whole = make_batch_invariant(self._function, tensors[0].shape[0], tensors[0].device)(*tensors)
            for target, result in zip(out, (whole,) if isinstance(whole, Tensor) else whole, strict=False):
                target.copy_(result)
            return whole
        results = self._rows(*tensors, out=out)
        return cast("Result", results[0] if self._single else results)

    def trace_kernel(self, tensors: Sequence[Tensor]) -> str:
        """Make the kernel for such tensors; return the reason of a failure, else an empty string."""

        def evaluate(*inputs: Tensor) -> Result:
            result = self._function(*inputs)
            self._single = isinstance(result, Tensor)
            return result

        try:
            self._rows = RowFunction(evaluate, tensors)
        except UntraceableError as error:
            return str(error) or "it cannot be traced"
        return ""


class GradientGraph:
    """Values by name with their gradients: of the simulation, and of the buffers that the task writes."""

    def __init__(self, simulation: DifferentiableBackend) -> None:
        self._simulation = simulation
        self._own: dict[str, Tensor] = {}
        self._places: dict[str, Tensor] = {}

    def tensors_with_gradients(self, reads: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return tensors by name: with their gradients where they have any, else as copies."""
        motion = self._simulation.gradient_tensors
        tensors: dict[str, Tensor] = {}
        for name, tensor in reads.items():
            if name in motion:
                tensors[name] = motion[name]
            else:
                tensors[name] = self._own[name] if name in self._own else tensor.clone()
        return tensors

    def store_values(self, written: Mapping[str, Tensor]) -> None:
        """Store new values of buffers, with their gradients."""
        self._own |= written

    def detach(self) -> None:
        """Cut the gradients at this instant."""
        self._own = {name: tensor.detach() for name, tensor in self._own.items()}

    def detach_in_place(self) -> None:
        """Cut the gradients at this instant, in tensors that stay the same at every call."""
        self._own = copy_tensors(self._places, self._own)

    def drop_values(self) -> None:
        """Drop the stored values, as the buffers were written from outside."""
        self._own.clear()


class StepKernel:
    """A pure function from named tensors to named tensors, run as one kernel; some results are written in place."""

    def __init__(
        self, function: Callable[[Mapping[str, Tensor]], dict[str, Tensor]], label: str, *,
        reads: Mapping[str, Tensor], writes: Mapping[str, Tensor], terms: Sequence[BoundTerm] = (),
        graph: GradientGraph | None = None, keeps: Collection[str] | None = None,
    ) -> None:  # fmt: skip
        """Take the function and fixed tensors.

        Args:
            function: Pure; gives at least every name of ``writes``.
            reads: Inputs by name; the first is (E, ...).
            writes: Tensors that receive results, by name; they may be read as well.
            terms: Called by the function. An untraceable one runs before the kernel, as separate torch operations.
            graph: Values with gradients; the function then runs as torch operations with gradients.
            keeps: Names of ``writes`` with gradients in later steps; all of them if not given.
        """
        self._graph, self._keeps = graph, tuple(writes if keeps is None else keeps)
        self.what, self._function, self._reads, self._writes = label, function, dict(reads), tuple(writes)
        self.apart: tuple[BoundTerm, ...] = ()  # The terms that run before the kernel
        self._names, self._results = tuple(self._reads), ()
        self._out = tuple(writes.values())
        self._kernels: DifferentiableRows | None = None
        self._tried = False
        self._rows = RowKernel(self._evaluate, label)
        if graph is None and self._rows.trace_kernel(list(self._reads.values())):
            self.apart = tuple(term for term in terms if not self._is_traceable(term))
            self._names += tuple(term.label for term in self.apart)

    @property
    def reason(self) -> str | None:
        """Reason for running as torch operations, or None."""
        return self._rows.reason

    def __call__(self, **changing: Tensor) -> dict[str, Tensor]:
        """Return all results by name; ``changing`` replaces inputs of these names."""
        if self._graph is not None:
            return self._run_with_gradients(self._graph, changing)
        values = {**self._reads, **changing}
        values |= {term.label: self._evaluate_separately(term, values) for term in self.apart}
        results = self._rows(*(values[name] for name in self._names), out=self._out)
        return dict(zip(self._results, results, strict=True))

    def _run_with_gradients(self, graph: GradientGraph, changing: Mapping[str, Tensor]) -> dict[str, Tensor]:
        values = {**graph.tensors_with_gradients(self._reads), **changing}
        outputs = self._results_with_gradients(*(values[name] for name in self._names))
        results = dict(zip(self._results, outputs, strict=True))
        with torch.no_grad():
            for target, result in zip(self._out, outputs, strict=False):
                target.copy_(result)
        graph.store_values({name: results[name] for name in self._keeps})
        return results

    def _results_with_gradients(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Return the results with their gradients: by two kernels if that can be, of float32, else by torch operations."""
        if not self._tried:
            self._tried = True
            try:
                if all(tensor.dtype != torch.float64 for tensor in given):
                    ends = [name for name in self._writes if name not in self._keeps]
                    self._kernels = DifferentiableRows(
                        self._evaluate, given, has_gradient=lambda place: self._results[place] not in ends
                    )
            except UntraceableError as error:
                _log.warning("gradients of %s run as many small torch operations: %s", self.what, error)
        if self._kernels is not None:
            return self._kernels(*given)
        return make_batch_invariant(self._evaluate, given[0].shape[0], given[0].device)(*given)

    def compute_by_torch(self, **changing: Tensor) -> dict[str, Tensor]:
        """Return all results by torch operations, without writing outputs."""
        values = {**self._reads, **changing}
        return self._function(values | {term.label: self._evaluate_separately(term, values) for term in self.apart})

    def _evaluate(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        results = self._function(dict(zip(self._names, tensors, strict=True)))
        self._results = (*self._writes, *(name for name in results if name not in self._writes))
        return tuple(results[name].clone() for name in self._results)  # none is an input that is written

    def _is_traceable(self, term: BoundTerm) -> bool:
        names, tensors = term.reads, [self._reads[name] for name in term.reads]
        try:
            trace(lambda *given: term.evaluate(dict(zip(names, given, strict=True))), tensors)
        except UntraceableError as error:
            if all(
                tensor[:1].numel() <= LARGEST_ROW for tensor in tensors if tensor.ndim
            ):  # without a warning for images
                _log.warning("%s runs as torch operations of its own: %s", term.label, error)
            return False
        return True

    def _evaluate_separately(self, term: BoundTerm, values: Mapping[str, Tensor]) -> Tensor:
        tensors = [values[name] for name in term.reads]
        first = next(iter(self._reads.values()))
        whole = make_batch_invariant(
            lambda *given: term.evaluate(dict(zip(term.reads, given, strict=True))), first.shape[0], first.device
        )
        return whole(*tensors)
