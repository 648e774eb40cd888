"""The control law in the fused kernel: Warp code traced from its torch functions, and the numbers that it reads.

Tensors that a law reads, such as gains and limits, are found by the trace: each is a field of the struct ``law``, with those
entries only that are read.
Letters: E environments, R rotors, U entries of an action, M numbers of memory.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import warp as wp
from torch import Tensor

from aerial_gym.interop.rows.warp_function import function_lines, split_function_lines
from aerial_gym.math.warp_functions import vector_type
from aerial_gym.physics.fused.law_step import MemoryAccess, make_memory_access, make_memory_step
from aerial_gym.physics.fused.torch_trace import ArgumentsTrace, compile_traced, constructors, trace_arguments
from aerial_gym.physics.law_memory import LawNeeds, law_needs
from aerial_gym.physics.state import BodyState
from aerial_gym.physics.vehicle import Vehicle, is_shared

MOTION = {"position": wp.vec3, "attitude": wp.quat, "lin_vel": wp.vec3, "ang_vel": wp.vec3}
"""Warp types of the motion of a law's ``BodyState``; the rotor states follow them."""


@dataclass(frozen=True)
class LawField:
    """A tensor that a law reads."""

    name: str  # In the struct
    tensor: Tensor  # (E, ...)
    entries: tuple[int, ...]  # Of a row, in the order of the struct's vector


@dataclass(frozen=True, kw_only=True)
class FusedLaw:
    """A control law as Warp code with its numbers."""

    num_actions: int  # U
    struct: Any  # ``wp.struct`` of the fields
    fields: tuple[LawField, ...]
    prepare: wp.Function | None  # `wp.func` (action, struct) -> vector, once per launch; None: the action itself
    num_prepared: int  # Length of that vector

    command: wp.Function
    """``wp.func`` (position, attitude, lin_vel, ang_vel, rotor states, struct, prepared action) -> commanded rotor states.

    With memory its further arguments are ``memory.LawArrays`` and the environment."""

    needs: LawNeeds | None  # Memory that the law needs
    follow: Callable[[Vehicle], Mapping[str, Tensor]] | None  # From the vehicle of each row to dependent tensors
    followed: Mapping[str, str]  # Their names by the fields' names

    structure: "_Structure"  # Numbers of tensors that the trace took as constants

    def follow_vehicle(self, vehicle: Vehicle) -> "FusedLaw":
        """Return the law with the tensors that depend on a vehicle."""
        if self.follow is None:
            return self
        rows = self.follow(vehicle)
        fields = tuple(
            replace(field, tensor=rows[self.followed[field.name]]) if field.name in self.followed else field
            for field in self.fields
        )
        return replace(self, fields=fields)


class _Reads:
    """Entries of tensors that traced functions read, collected over several functions."""

    def __init__(self) -> None:
        self._tensors: dict[int, tuple[Tensor, dict[int, int]]] = {}

    def code(self, tensor: Tensor, entry: int) -> str:
        """Return the code of an entry of a tensor, and note it as read."""
        _, entries = self._tensors.setdefault(id(tensor), (tensor, {}))
        place = entries.setdefault(entry, len(entries))
        return f"law.p{list(self._tensors).index(id(tensor))}[{place}]"

    def reader(self, traced: ArgumentsTrace) -> Callable[[int, int], str]:
        """Return the function from position and entry of an input of a trace to its code."""
        count = len(traced.inputs)

        def code_of_entry(position: int, entry: int) -> str:
            if position < count:
                return traced.code_of_entry(position, entry)
            return self.code(traced.trace.sources[position - count], entry)

        return code_of_entry

    def fields(self) -> tuple[LawField, ...]:
        """Return the fields of the struct."""
        return tuple(
            LawField(f"p{k}", tensor, tuple(entries)) for k, (tensor, entries) in enumerate(self._tensors.values())
        )


MAPS = ("thrust_map", "reverse_thrust_map")  # Tensors whose zeros stay: randomisation multiplies maps by a factor


class _Structure:
    """Entries of tensors that a trace takes as constants, because other robots of equal structure have them too."""

    def __init__(self, followed: Mapping[int, str]) -> None:
        """Start without any; ``followed``: names of tensors that follow the vehicle, by their ids."""
        self._followed = followed
        self._known: list[tuple[Tensor, dict[int, float]]] = []

    def note_entries(self, tensor: Tensor) -> dict[int, float]:
        """Return the entries of a tensor's rows that are structure, and note them."""
        self._known.append((tensor, self._find_entries(tensor)))
        return self._known[-1][1]

    def is_unchanged(self) -> bool:
        """Return whether the tensors still have these numbers; waits for the device."""
        return all(known.items() <= self._find_entries(tensor).items() for tensor, known in self._known)

    def _find_entries(self, tensor: Tensor) -> dict[int, float]:
        """Return the entries that are 0, 1 or -1 if shared, and zeros of followed maps; other numbers need no compilation."""
        if is_shared(tensor):
            numbers = tensor[0].detach().flatten().tolist()
            return {i: value for i, value in enumerate(numbers) if value in (0.0, 1.0, -1.0)}
        if self._followed.get(id(tensor)) in MAPS:
            return {i: 0.0 for i, differs in enumerate(tensor.flatten(1).any(0).tolist()) if not differs}
        return {}


@cache
def _struct_of_widths(widths: tuple[int, ...]) -> Any:
    """Return the ``wp.struct`` with a vector of each width, ``p0``, ``p1``, ..."""
    fields = {f"p{k}": vector_type(width) for k, width in enumerate(widths)} or {"unused": float}
    return wp.struct(type("LawParameters", (), {"__annotations__": fields, "__module__": __name__}))


def fuse_law(control: Any, num_envs: int, num_rotors: int, *, differentiable: bool = False) -> FusedLaw:
    """Return a control law as Warp code, traced from its torch functions.

    Args:
        control: Control law with ``action_names`` and ``rotor_command``; one with ``needs`` has ``outer`` and ``inner``.
        differentiable: Whether the adjoint is needed.

    Raises:
        CapabilityError: If a function cannot be traced; the text states the cause and its place in the source.
    """
    needs, num_actions = law_needs(control), len(control.action_names)
    allocation = getattr(control, "allocation", None)
    rows = {} if allocation is None else {id(tensor): name for name, tensor in allocation.rows.items()}
    reads, structure, vector = _Reads(), _Structure(rows), vector_type(num_rotors)

    def trace_law(name: str, more: Mapping[str, Any], function: Callable[..., Any]) -> ArgumentsTrace:
        return trace_arguments(
            f"{type(control).__name__}.{name}",
            MOTION | {"rotor_speed": vector} | more,
            function,
            num_envs=num_envs,
            lifts=True,
            known=None if differentiable else structure.note_entries,
        )

    make = _fuse_without_memory if needs is None else _fuse_with_memory
    traced = make(control, trace_law, reads, num_actions, vector)
    fields = reads.fields()
    struct = _struct_of_widths(tuple(len(field.entries) for field in fields))
    prepare, num_prepared, command = traced(struct, differentiable)
    return FusedLaw(
        num_actions=num_actions,
        struct=struct,
        fields=fields,
        prepare=prepare,
        num_prepared=num_prepared,
        command=command,
        needs=needs,
        follow=allocation.compute_rows if rows else None,
        followed={field.name: rows[id(field.tensor)] for field in fields if id(field.tensor) in rows},
        structure=structure,
    )


TraceLaw = Callable[[str, Mapping[str, Any], Callable[..., Any]], ArgumentsTrace]

Compile = Callable[[Any, bool], tuple[wp.Function | None, int, wp.Function]]
"""From the struct and whether the adjoint is needed to ``prepare``, ``num_prepared`` and ``command`` of a ``FusedLaw``."""


def _fuse_without_memory(control: Any, trace_law: TraceLaw, reads: _Reads, num_actions: int, vector: Any) -> Compile:
    action_type = vector_type(num_actions)
    motion = MOTION | {"rotor_speed": vector}

    def rows(action: Tensor, **motion: Tensor) -> Tensor:
        return control.rotor_command(BodyState(**motion), action)

    traced = trace_law("rotor_command", {"action": action_type}, rows)
    early, late = traced.positions(["action"]), traced.positions(list(motion))
    first, second, width = split_function_lines(traced.trace, reads.reader(traced), constructors([vector]), early, late)
    prepared = vector_type(max(width, 1))

    def compile_law(struct: Any, differentiable: bool) -> tuple[wp.Function, int, wp.Function]:
        def compile_part(
            name: str, arguments: Mapping[str, Any], returns: Sequence[Any], lines: list[str]
        ) -> wp.Function:
            names = {"prepared_type": prepared}
            return compile_traced(
                name, arguments, returns, lines, traced.trace, differentiable=differentiable, names=names
            )

        prepare = compile_part("prepare_action", {"action": action_type, "law": struct}, (), first)
        command = compile_part("rotor_command", {**motion, "law": struct, "prepared": prepared}, (vector,), second)
        return prepare, prepared._length_, command

    return compile_law


def _fuse_with_memory(control: Any, trace_law: TraceLaw, reads: _Reads, num_actions: int, vector: Any) -> Compile:
    needs: LawNeeds = control.needs
    motion = MOTION | {"rotor_speed": vector}
    levels: list[tuple[str, dict[str, Any], list[Any], ArgumentsTrace, list[str], MemoryAccess]] = []
    for name, function, kind, result, first, width in (
        ("outer", control.outer, vector_type(num_actions), vector_type(needs.num_setpoint), needs.inner, needs.outer),
        ("inner", control.inner, vector_type(needs.num_setpoint), vector, 0, needs.inner),
    ):
        memory = vector_type(max(width, 1))

        def rows(
            signal: Tensor, memory: Tensor, begins: Tensor, function: Any = function, width: int = width,
            **motion: Tensor,
        ) -> tuple[Tensor, ...]:  # fmt: skip
            made, after = function(BodyState(**motion), signal, memory[:, :width], begins.unsqueeze(-1))
            return (made, after) if width else (made,)

        more = {"signal": kind, "memory": memory, "begins": bool}
        traced = trace_law(name, more, rows)
        returns = [result, memory][: 1 + bool(width)]
        lines = function_lines(traced.trace, reads.reader(traced), constructors(returns))
        access = make_memory_access(memory, width, first, _entries_to_store(traced) if width else [])
        levels.append((name, motion | more, returns, traced, lines, access))

    def compile_law(struct: Any, differentiable: bool) -> tuple[None, int, wp.Function]:
        outer, inner = (
            compile_traced(
                name, arguments | {"law": struct}, returns, lines, traced.trace, differentiable=differentiable
            )
            for name, arguments, returns, traced, lines, _ in levels
        )
        step = make_memory_step(needs, vector, struct, (outer, levels[0][-1]), (inner, levels[1][-1]))
        return None, num_actions, step

    return compile_law


def _entries_to_store(traced: ArgumentsTrace) -> list[int]:
    """Return the entries of the memory, the second result, that the function changes from those it got."""
    (position,) = traced.positions(["memory"])
    numbers = traced.trace.outputs[1][0]
    scalars = [traced.trace.scalars[n] for n in numbers]
    return [
        i
        for i, scalar in enumerate(scalars)
        if (scalar.kind, scalar.args) not in (("input", (position, i)), ("constant", (0.0,)))
    ]


def preparation(law: FusedLaw) -> wp.Function:
    """Return ``FusedLaw.prepare``, or the identity without one."""
    action_type, struct = vector_type(law.num_actions), law.struct

    @wp.func
    def identity(action: action_type, numbers: struct) -> action_type:
        return action

    return identity if law.prepare is None else law.prepare
