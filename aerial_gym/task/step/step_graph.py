"""A task step as one CUDA graph: recorded once, then replayed with a single launch.

Letters: E environments, U entries of an action.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Generic, TypeVar

import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError, ShapeError
from aerial_gym.interop import record_graph
from aerial_gym.task.step.row_kernels import StepKernel

WARM_UP_STEPS = 3  # Steps before the recording, in which kernels are compiled and memory is taken

Result = TypeVar("Result")


def check_terms_never_wait(terms: Mapping[str, Callable[[], object]]) -> None:
    """Call every term once and refuse the one that waits for the GPU, by name."""
    mode = torch.cuda.get_sync_debug_mode()
    for name, call in terms.items():
        torch.cuda.synchronize()
        torch.cuda.set_sync_debug_mode("error")
        try:
            call()
        except Exception as error:
            reason = str(error).strip().splitlines()[0]
            raise CapabilityError(
                f"{name} cannot be held in a CUDA graph: {reason}. Write it without .item(), printing or branches on "
                "tensors, or make the task with capture=False"
            ) from error
        finally:
            torch.cuda.set_sync_debug_mode(mode)


def check_untraced_terms(parts: Sequence[StepKernel], values: Mapping[str, Tensor]) -> None:
    """Refuse terms that wait for the GPU; only terms that run as torch operations can."""
    for rows in parts:
        rows()
    asked: dict[str, Callable[[], object]] = {}
    for rows in parts:
        asked |= {term.label: partial(term.evaluate, values) for term in rows.apart}
        if rows.reason is not None:
            asked[rows.what] = rows.compute_by_torch
    check_terms_never_wait(asked)


class StepGraph(Generic[Result]):
    """A recorded step. The tensors that it returns are the same at every replay and are then overwritten."""

    def __init__(self, step: Callable[[Tensor], Result], actions_shape: tuple[int, ...], device: torch.device) -> None:
        """Record ``step``, which takes actions (E, U); its random numbers come from counters on the device, and so advance."""
        self._step = step  # kept, with all memory that its launches read: a graph does not keep it
        self._actions = torch.zeros(actions_shape, device=device)
        stream = torch.cuda.Stream(device)
        stream.wait_stream(torch.cuda.current_stream(device))
        with torch.cuda.stream(stream):
            for _ in range(WARM_UP_STEPS):
                step(self._actions)
        torch.cuda.current_stream(device).wait_stream(stream)
        self._graph = torch.cuda.CUDAGraph()
        try:
            with record_graph(self._graph, device):
                self._result = step(self._actions)
        except RuntimeError as error:
            reason = str(error).strip().splitlines()[0]
            raise CapabilityError(
                f"this task's step cannot be held in a CUDA graph: {reason}. Make the task with capture=False"
            ) from error

    def replay(self, actions: Tensor) -> Result:
        """Replay the recorded step with these actions, (E, U), and return its results."""
        if actions.shape != self._actions.shape:
            raise ShapeError(
                f"actions has shape {tuple(actions.shape)}, expected (E, U) = {tuple(self._actions.shape)}"
            )
        self._actions.copy_(actions)
        self._graph.replay()
        return self._result
