"""An iteration of a learner as one CUDA graph, simulation and update together; on a CPU it runs as it is."""

import logging
from collections.abc import Callable

import torch

from aerial_gym.errors import CapabilityError
from aerial_gym.interop import record_graph

WARM_UP_ITERATIONS = 2
"""Iterations before the recording, in which kernels are compiled and memory is taken; they count as all others do."""

_log = logging.getLogger(__name__)


class IterationGraph:
    """Repeated calls of a function without waits on fixed tensors; on CUDA a recorded graph."""

    def __init__(
        self,
        iterate: Callable[[], None],
        device: torch.device,
        *,
        generator: torch.Generator,
        joined: bool = False,
        capture: bool = True,
    ) -> None:
        """Take the function, the generator that it draws from, whether it talks to other processes, whether to record it."""
        self._iterate, self._device, self._generator = iterate, device, generator
        # NCCL has a thread that polls events: a recording that forbids this to all threads would fail.
        self._forbids = "thread_local" if joined else "global"
        self._graph: torch.cuda.CUDAGraph | None = None
        self._warm = 0
        self._stream = torch.cuda.Stream(device) if capture and device.type == "cuda" else None

    @property
    def is_captured(self) -> bool:
        """Whether an iteration is the replay of a graph by now."""
        return self._graph is not None

    def __call__(self) -> None:
        """Run it once; on a GPU not waited for."""
        if self._stream is None:
            self._iterate()
        elif self._warm < WARM_UP_ITERATIONS:
            self._warm += 1
            self._stream.wait_stream(torch.cuda.current_stream(self._device))
            with torch.cuda.stream(self._stream):
                self._iterate()
            torch.cuda.current_stream(self._device).wait_stream(self._stream)
        else:
            self._record().replay()

    def _record(self) -> torch.cuda.CUDAGraph:
        """Return the graph; raise ``CapabilityError`` if something in an iteration waits for the GPU."""
        if self._graph is None:
            graph = torch.cuda.CUDAGraph()
            graph.register_generator_state(self._generator)
            try:
                with record_graph(graph, self._device, errors=self._forbids):
                    self._iterate()
            except RuntimeError as error:
                reason = str(error).strip().splitlines()[0]
                raise CapabilityError(
                    f"this training cannot be held in a CUDA graph: {reason}. Terms and rewards must not use .item(), print "
                    "or branch on tensors; or train on the CPU"
                ) from error
            self._graph = graph
        return self._graph
