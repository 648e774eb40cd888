"""Tensors that report writes, for parameters in the Global Tensor Dictionary.

A guarded tensor shares the memory of a plain one. PyTorch's own schema of an operation says which arguments it writes, so that
every operation counts: assignment, ``add_``, ``out=``, and those of views. A write is refused, or goes through and is reported.
Results in memory of their own are plain tensors. Arrays made by ``numpy()`` refuse writes; what DLPack or a Warp kernel writes
is not noticed.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
import torch
from torch import Tensor
from torch.utils._pytree import tree_map

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
        del types
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
        del value
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
