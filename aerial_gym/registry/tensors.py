"""The Global Tensor Dictionary (GTD): every tensor that crosses the boundary of a manager.

Each key is declared once by its owner with shape letters, dtype, unit, frame and meaning; it is allocated then and never
replaced, so that views stay valid and a step can be captured in a CUDA graph. The owner writes in place, to the tensor that
``declare`` returned. Everyone else gets parameters as guarded tensors: a write is either taken into the next step
(``watch``), or refused (``refuse``).
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import NoReturn

import torch
from torch import Tensor

from aerial_gym.errors import DuplicateNameError, OwnershipError, ShapeError, UnknownNameError
from aerial_gym.interop import plain_device
from aerial_gym.registry.write_guard import WriteGuardTensor


@dataclass(frozen=True, kw_only=True)
class TensorSpec:
    """Declaration of one GTD key."""

    key: str  # Name under which the tensor is found
    shape: tuple[str | int, ...]  # Letters (E environments, R rotors, A obstacles, S sensors, H x W pixels) or numbers
    unit: str  # SI unit; `-` for none
    frame: str  # `world`, `body`, `vehicle` (world turned by yaw only), `sensor` or `-`
    owner: str  # The only part that writes
    meaning: str  # One line
    dtype: torch.dtype = torch.float32  # Element type


class GlobalTensorDictionary(Mapping[str, Tensor]):
    """Read-only mapping from declared keys to tensors of fixed address; ``print`` shows the schema."""

    def __init__(self, *, device: str | torch.device, sizes: Mapping[str, int]) -> None:
        self.device = plain_device(device)
        self._sizes = dict(sizes)
        self._specs: dict[str, TensorSpec] = {}
        self._tensors: dict[str, Tensor] = {}
        self._guarded: dict[str, Tensor] = {}
        self._instead: dict[str, str] = {}

    def define_size(self, letter: str, size: int) -> None:
        """Define the size of a shape letter; a different second size is an error."""
        if self._sizes.setdefault(letter, size) != size:
            raise ShapeError(f"size {letter} = {size}: it is {self._sizes[letter]} already")

    def resolve(self, shape: tuple[str | int, ...]) -> tuple[int, ...]:
        """Return the shape in numbers."""
        for letter in shape:
            if isinstance(letter, str) and letter not in self._sizes:
                raise ShapeError(f"shape letter {letter!r} has no size. Known: {', '.join(self._sizes)}")
        return tuple(letter if isinstance(letter, int) else self._sizes[letter] for letter in shape)

    def declare(self, spec: TensorSpec, *, view: Tensor | None = None) -> Tensor:
        """Allocate the tensor of ``spec`` with zeros, or take ``view`` of declared memory, and return it."""
        if spec.key in self._specs:
            raise DuplicateNameError(f"GTD key {spec.key!r} is declared already, by {self._specs[spec.key].owner}")
        shape = self.resolve(spec.shape)
        tensor = torch.zeros(shape, dtype=spec.dtype, device=self.device) if view is None else view
        if tensor.shape != shape or tensor.dtype != spec.dtype or tensor.device.type != self.device.type:
            raise ShapeError(
                f"GTD key {spec.key!r}: view is {tuple(tensor.shape)} {tensor.dtype} on {tensor.device}, "
                f"declared {shape} {spec.dtype} on {self.device}"
            )
        self._specs[spec.key], self._tensors[spec.key] = spec, tensor
        return tensor

    def refuse(self, key: str, instead: str) -> None:
        """Refuse writes to a key from now on; ``instead`` is the remedy in the error message."""
        self._instead[key] = instead
        self._guarded[key] = WriteGuardTensor.wrap(self.plain(key), partial(self._refuse_write, key), _ignore_write)

    def watch(self, key: str, notice: Callable[[], None]) -> None:
        """Call ``notice`` after each write to a key from now on."""
        self._guarded[key] = WriteGuardTensor.wrap(self.plain(key), _ignore_write, notice)

    def _refuse_write(self, key: str) -> NoReturn:
        raise OwnershipError(f"GTD key {key!r} is read-only: {self._instead[key]}")

    def spec(self, key: str) -> TensorSpec:
        """Return the declaration of a key."""
        self[key]
        return self._specs[key]

    def plain(self, key: str) -> Tensor:
        """Return the tensor of a key without its guard, for its owner and for parts of a step that read it."""
        try:
            return self._tensors[key]
        except KeyError:
            known = ", ".join(sorted(self._tensors)) or "none"
            raise UnknownNameError(f"no GTD key {key!r}. Known: {known}") from None

    def state_tensors(self) -> dict[str, Tensor]:
        """Return all tensors except views of another one."""
        whole = {}
        for key, tensor in self._tensors.items():
            storage = tensor.untyped_storage()
            if tensor.numel() and storage.nbytes() == tensor.numel() * tensor.element_size():
                whole.setdefault(storage.data_ptr(), key)
        return {
            key: tensor
            for key, tensor in self._tensors.items()
            if tensor.numel() and whole.get(tensor.untyped_storage().data_ptr(), key) == key
        }

    def __getitem__(self, key: str) -> Tensor:
        return self._guarded[key] if key in self._guarded else self.plain(key)

    def __setitem__(self, key: str, value: object) -> NoReturn:
        raise OwnershipError(f"GTD key {key!r} cannot be replaced: write in place, gtd[{key!r}][:] = value")

    def __contains__(self, key: object) -> bool:
        return key in self._tensors

    def __iter__(self) -> Iterator[str]:
        return iter(self._tensors)

    def __len__(self) -> int:
        return len(self._tensors)

    def __str__(self) -> str:
        head = ("key", "shape", "dtype", "unit", "frame", "owner", "meaning")
        rows = [head, *(self._table_row(spec) for spec in self._specs.values())]
        widths = [max(len(row[i]) for row in rows) for i in range(len(head) - 1)]
        return "\n".join(
            "  ".join([*(cell.ljust(width) for cell, width in zip(row, widths, strict=False)), row[-1]]) for row in rows
        )

    def _table_row(self, spec: TensorSpec) -> tuple[str, ...]:
        letters = "(" + ", ".join(str(letter) for letter in spec.shape) + ")"
        numbers = "(" + ", ".join(str(size) for size in self._tensors[spec.key].shape) + ")"
        shape = letters if letters == numbers else f"{letters} = {numbers}"
        dtype = str(spec.dtype).removeprefix("torch.")
        meaning = f"{spec.meaning} (read-only)" if spec.key in self._instead else spec.meaning
        return spec.key, shape, dtype, spec.unit, spec.frame, spec.owner, meaning


def _ignore_write() -> None: ...
