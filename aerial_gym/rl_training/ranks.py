"""The processes of one training: ``torchrun`` starts them; each has a rank and simulates its own environments.

Only this file uses ``torch.distributed``. Tensors go by NCCL between GPUs, where calls can be part of a CUDA graph, and by
Gloo between CPUs; host objects go by Gloo. All processes make the same
calls in the same order.

Letters: R processes, N samples, O entries of a sample.
"""

import gc
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError, TrainingError
from aerial_gym.interop import resolve_device

Value = TypeVar("Value")

VARIABLES = ("RANK", "LOCAL_RANK", "WORLD_SIZE", "MASTER_ADDR", "MASTER_PORT")
"""Environment variables that ``torchrun`` sets in each process."""


class Ranks:
    """One of R processes of a training; with R = 1 every call returns its argument unchanged."""

    def __init__(self, rank: int = 0, size: int = 1, *, joined: bool = False) -> None:
        self.rank, self.size, self.joined = rank, size, joined

    @property
    def is_leader(self) -> bool:
        """Whether this is the process that decides, and writes files."""
        return self.rank == 0

    def mean_(self, tensor: Tensor) -> Tensor:
        """Replace a tensor by its mean over all processes, and return it."""
        self.sum_(tensor)
        return tensor.div_(self.size) if self.size > 1 else tensor

    def sum_(self, tensor: Tensor) -> Tensor:
        """Replace a tensor by its sum over all processes and return it, bit-equal in all."""
        if self.joined:
            with _report_peer_end():
                torch.distributed.all_reduce(tensor)
        return tensor

    def var_mean(self, samples: Tensor) -> tuple[Tensor, Tensor]:
        """Return variance and mean, (O), over the samples (N, O) of all processes, as many in each. The variance is the mean
        of theirs, plus that of their means: exact, and without differences of large numbers."""
        var, mean = torch.var_mean(samples, dim=0, correction=0)
        if not self.joined:
            return var, mean
        each = var.new_zeros(self.size, 2, *var.shape)
        torch.stack((var, mean), out=each[self.rank])
        self.sum_(each)
        between, mean = torch.var_mean(each[:, 1], dim=0, correction=0)
        return each[:, 0].mean(0) + between, mean

    def share_(self, tensors: Iterable[Tensor]) -> None:
        """Overwrite tensors with those of rank 0."""
        if self.joined:
            with _report_peer_end():
                for tensor in tensors:
                    torch.distributed.broadcast(tensor, 0)

    def broadcast_number(self, value: float) -> float:
        """Return a number from rank 0 in all processes."""
        number = torch.tensor(value, dtype=torch.float64)
        self.share_([number])
        return float(number)

    def broadcast(self, value: Value) -> Value:
        """Return an object from rank 0 in all processes."""
        if not self.joined:
            return value
        objects: list[Any] = [value if self.is_leader else None]
        with _report_peer_end():
            torch.distributed.broadcast_object_list(objects, 0, device=torch.device("cpu"))
        return objects[0]

    def any(self, flag: bool) -> bool:
        """Return whether any process says so."""
        return bool(self.sum_(torch.tensor(float(flag))) > 0.0)

    def gather(self, value: Mapping[str, object]) -> list[Mapping[str, Any]]:
        """Return the values of the other processes by rank, in rank 0; an empty list elsewhere."""
        if self.size == 1:
            return []
        objects: list[Any] | None = [None] * self.size if self.is_leader else None
        with _report_peer_end():
            torch.distributed.gather_object(_copy_to_cpu(value), objects, 0)
        return [] if objects is None else objects[1:]


ALONE = Ranks()  # A training in one process


def torchrun_rank() -> int:
    """Return the rank of this process under ``torchrun``; 0 without it."""
    return int(os.environ["RANK"]) if all(name in os.environ for name in VARIABLES) else 0


def process_device(name: str) -> str:
    """Return the device of this process: for ``auto`` or ``cuda`` the GPU of its ``LOCAL_RANK``, if there are GPUs."""
    device = resolve_device(name)
    if device.type != "cuda" or not all(name in os.environ for name in VARIABLES):
        return name
    local, size, count = int(os.environ["LOCAL_RANK"]), int(os.environ["WORLD_SIZE"]), torch.cuda.device_count()
    if ":" in name and size > 1:
        raise ConfigError(f"device {name!r}: each of {size} processes takes a GPU of its own. Leave the number out")
    if local >= count:
        raise ConfigError(
            f"LOCAL_RANK {local}: this machine shows {count} GPUs, one for each process. Start fewer with --nproc-per-node"
        )
    return f"cuda:{local}"


@contextmanager
def join_ranks(device: str) -> Iterator[Ranks]:
    """Join the process group of ``torchrun`` on a device; ``ALONE`` without it."""
    if not all(name in os.environ for name in VARIABLES):
        yield ALONE
        return
    kind = torch.device("cpu")
    if resolve_device(device).type == "cuda":
        kind = torch.device(process_device(device))
        torch.cuda.set_device(kind)
    with _report_peer_end():
        torch.distributed.init_process_group("cpu:gloo,cuda:nccl" if kind.type == "cuda" else "gloo")
    yield Ranks(torch.distributed.get_rank(), torch.distributed.get_world_size(), joined=True)
    # Not after an error: NCCL would wait for collectives that others never reach, and for graphs held by the traceback.
    gc.collect()  # graphs that hold calls of NCCL go before it
    torch.distributed.destroy_process_group()


def _copy_to_cpu(value: Any) -> Any:
    """Return nested mappings with their tensors on the CPU: a GPU is another one in another process."""
    if isinstance(value, Mapping):
        return {name: _copy_to_cpu(inner) for name, inner in value.items()}
    return value.cpu() if isinstance(value, Tensor) else value


@contextmanager
def _report_peer_end() -> Iterator[None]:
    """Raise ``TrainingError`` if another process has ended during a collective operation."""
    try:
        yield
    except RuntimeError as error:
        if isinstance(error, TrainingError):
            raise
        reason = (str(error).strip().splitlines() or ["no reason given"])[0]
        raise TrainingError(
            f"rank {torchrun_rank()}: the processes of this training cannot go on together ({reason}). If another one has "
            "ended, its own message says why"
        ) from error
