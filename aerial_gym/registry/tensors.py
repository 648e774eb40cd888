"""The Global Tensor Dictionary (GTD): every tensor that crosses the boundary of a manager.

Each key is declared once by its owner with shape letters, dtype, unit, frame and meaning; it is allocated then and never
replaced, so that views stay valid and a step can be captured in a CUDA graph. The owner writes in place, to the tensor that
``declare`` returned. Everyone else gets parameters as guarded tensors, which share the memory of plain ones: a write is either
taken into the next step (``watch``), or refused (``refuse``). PyTorch's own schema of an operation says which arguments it
writes, so that every operation counts: assignment, ``add_``, ``out=``, and those of views. Results in memory of their own are
plain tensors. Arrays made by ``numpy()`` refuse writes; what DLPack or a Warp kernel writes is not noticed.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NoReturn

import numpy as np
import torch
from torch import Tensor
from torch.utils._pytree import tree_map

from aerial_gym.errors import DuplicateNameError, OwnershipError, ShapeError, UnknownNameError, suggest_name
from aerial_gym.interop import plain_device

KEPT = "memory and shape of a tensor in the GTD stay as declared: write its values in place, or take a view"


class WriteGuardTensor(Tensor):
    """A tensor that calls ``before`` ahead of each write and ``after`` behind it."""

    _plain: Tensor
    _before: Callable[[], None]
    _after: Callable[[], None]
    # results are no guarded tensors by themselves
    __torch_function__ = torch._C._disabled_torch_function_impl  # pyright: ignore[reportAssignmentType]

    @staticmethod
    def wrap(plain: Tensor, before: Callable[[], None], after: Callable[[], None]) -> "WriteGuardTensor":
        """Return a guarded tensor in the memory of a plain one."""
        made = Tensor._make_subclass(WriteGuardTensor, plain)
        made._plain, made._before, made._after = plain, before, after
        return made

    @classmethod
    def __torch_dispatch__(
        cls, func: Any, types: Sequence[type], args: Sequence[Any] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        """Run an operation on the plain tensors, and guard results that share their memory."""
        kwargs = kwargs or {}
        written = _write_targets(func, args, kwargs)
        for each in written:
            each._before()
        if written and torch.Tag.inplace_view in func.tags:
            raise AttributeError(KEPT)
        result = func(*tree_map(_plain, list(args)), **tree_map(_plain, dict(kwargs)))
        for each in written:
            each._after()
        if all(each.alias_info is None for each in func._schema.returns):
            return result
        source = next((each for each in _find_guards(args, kwargs)), None)
        return result if source is None else tree_map(source._wrap_like, result)

    def _wrap_like(self, made: Any) -> Any:
        return WriteGuardTensor.wrap(made, self._before, self._after) if isinstance(made, Tensor) else made

    def numpy(self, *, force: bool = False) -> np.ndarray:
        """Return an array of the same memory that refuses writes."""
        array = self._plain.numpy(force=force)
        array.flags.writeable = False
        return array

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        array = self.numpy() if dtype is None else self.numpy().astype(dtype, copy=False)
        return array.copy() if copy else array

    def tolist(self) -> Any:
        """Return the numbers."""
        return self._plain.tolist()

    @property
    def data(self) -> Tensor:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The tensor itself, guarded likewise."""
        return self.detach()

    @data.setter
    def data(self, value: Tensor) -> NoReturn:
        raise AttributeError(KEPT)

    def __repr__(self) -> str:  # pyright: ignore[reportIncompatibleMethodOverride]
        return repr(self._plain)

    def __deepcopy__(self, memo: Any) -> Tensor:
        return self._plain.detach().clone()

    def __reduce_ex__(self, protocol: Any) -> Any:
        return self._plain.detach().__reduce_ex__(protocol)


_IN_PLACE = {
    "add": "add_", "sub": "sub_", "mul": "mul_", "truediv": "div_", "floordiv": "floor_divide_", "mod": "remainder_",
    "pow": "pow_", "and": "bitwise_and_", "or": "bitwise_or_", "xor": "bitwise_xor_", "lshift": "bitwise_left_shift_",
    "rshift": "bitwise_right_shift_",
}  # fmt: skip
"""Methods behind augmented assignment. PyTorch's own operators take a ``TypeError`` for 'not implemented' and ignore it."""


for _name, _method in _IN_PLACE.items():
    setattr(WriteGuardTensor, f"__i{_name}__", lambda self, other, method=_method: getattr(self, method)(other))


def _plain(value: Any) -> Any:
    return value._plain if isinstance(value, WriteGuardTensor) else value


def _find_guards(args: Sequence[Any], kwargs: Mapping[str, Any]) -> list[WriteGuardTensor]:
    guards: list[WriteGuardTensor] = []
    tree_map(
        lambda value: guards.append(value) if isinstance(value, WriteGuardTensor) else None, (list(args), dict(kwargs))
    )
    return guards


def _write_targets(func: Any, args: Sequence[Any], kwargs: Mapping[str, Any]) -> list[WriteGuardTensor]:
    """Return the guarded tensors that an operation writes, by its schema."""
    given = {each.name: value for each, value in zip(func._schema.arguments, args, strict=False)} | dict(kwargs)
    targets = [
        given.get(each.name)
        for each in func._schema.arguments
        if each.alias_info is not None and each.alias_info.is_write
    ]
    return _find_guards(targets, {})


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

    def numeric_shape(self, shape: tuple[str | int, ...]) -> tuple[int, ...]:
        """Return a shape with each letter replaced by its size."""
        for letter in shape:
            if isinstance(letter, str) and letter not in self._sizes:
                raise ShapeError(f"shape letter {letter!r} has no size. Known: {', '.join(self._sizes)}")
        return tuple(letter if isinstance(letter, int) else self._sizes[letter] for letter in shape)

    def declare(self, spec: TensorSpec, *, view: Tensor | None = None) -> Tensor:
        """Allocate the tensor of ``spec`` with zeros, or take ``view`` of declared memory, and return it."""
        if spec.key in self._specs:
            raise DuplicateNameError(f"GTD key {spec.key!r} is declared already, by {self._specs[spec.key].owner}")
        shape = self.numeric_shape(spec.shape)
        tensor = torch.zeros(shape, dtype=spec.dtype, device=self.device) if view is None else view
        if tensor.shape != shape or tensor.dtype != spec.dtype or tensor.device.type != self.device.type:
            raise ShapeError(
                f"GTD key {spec.key!r}: view is {tuple(tensor.shape)} {tensor.dtype} on {tensor.device}, "
                f"declared {shape} {spec.dtype} on {self.device}"
            )
        self._specs[spec.key], self._tensors[spec.key] = spec, tensor
        return tensor

    def adopt_bodies(self, bodies: "GlobalTensorDictionary") -> None:
        """Declare views (E, V, ...) of all tensors (E V, ...) of ``bodies``, with their guards; the letter V has its size."""
        for letter, size in bodies._sizes.items():
            if letter != "E":
                self.define_size(letter, size)
        rows = self.numeric_shape(("E", "V"))
        for key, spec in bodies._specs.items():
            shape = ("E", "V", *spec.shape[1:])
            self.declare(replace(spec, shape=shape), view=bodies.plain(key).unflatten(0, rows))
            if key in bodies._guarded:
                self._guarded[key] = bodies._guarded[key].unflatten(0, rows)
        self._instead |= bodies._instead

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
            raise UnknownNameError(f"no GTD key {key!r}.{suggest_name(key, self._tensors)} Known: {known}") from None

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

    def __repr__(self) -> str:
        sizes = ", ".join(f"{letter} = {size}" for letter, size in self._sizes.items())
        return f"GlobalTensorDictionary: {len(self)} tensors on {self.device}, {sizes}; print shows all"

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
