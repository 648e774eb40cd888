"""Inputs of a task's terms by name: GTD keys and the task's own buffers.

Task buffers are values of the previous step, declared like GTD keys and made when a term reads them. A buffer is a pure
function like a term, computed for all environments after every step and its resets, and read by terms of the next step. It may
read itself, and ``begun``, the mask of episodes that have just begun.
Letters: E environments, U entries of a command, V entries of an action.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.errors import DuplicateNameError, ShapeError, UnknownNameError, suggest_name
from aerial_gym.registry import GlobalTensorDictionary, Registry, TensorSpec
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.task.step.row_kernels import GradientGraph
from aerial_gym.task.terms.gate_path import gate_path_length
from aerial_gym.task.terms.term import (
    BoundTerm,
    Function,
    Term,
    bind_term,
    call_term,
    check_result,
    term_from_function,
)
from aerial_gym.task.vehicles.row_inputs import VehicleInputs


@dataclass(frozen=True, kw_only=True)
class Buffer:
    """Declaration of a buffer and its update after a step."""

    term: Term
    shape: tuple[int | str, ...]  # Of a row
    unit: str
    frame: str

    def __post_init__(self) -> None:
        sizes = self.shape if isinstance(self.shape, tuple) else (0,)
        if not all(isinstance(size, str) or (type(size) is int and size > 0) for size in sizes):
            raise ShapeError(
                f"{self.label}: shape = {self.shape!r}: must be a tuple of letters and whole numbers > 0, such as (3,), "
                "or () for one number"
            )

    @property
    def label(self) -> str:
        """Name and place of the declaration, for messages."""
        code = getattr(self.term.value, "__code__", None)
        place = f" ({Path(code.co_filename).name}:{code.co_firstlineno})" if code is not None else ""
        return f"task buffer {self.term.name!r}{place}"

    @property
    def summary(self) -> str:
        """One line about it."""
        return self.term.summary


class BufferRegistry(Registry[Buffer]):
    """Buffers by name."""

    def buffer(
        self, name: str | None = None, *, shape: tuple[int | str, ...] = (), unit: str = "-", frame: str = "-"
    ) -> Callable[[Function], Function]:
        """Register the function below as the update of a floating-point buffer after a step.

        Args:
            name: Under which terms read it; that of the function if not given.
            shape: Of a row; () for one number, letters such as ``U`` and ``R`` as in the GTD.
            frame: ``world``, ``body``, ``vehicle`` or ``-``.
        """

        def add(function: Function) -> Function:
            known = name or function.__name__
            self.register(known, Buffer(term=term_from_function(known, function), shape=shape, unit=unit, frame=frame))
            return function

        return add


BUFFERS = BufferRegistry("task buffer")  # Buffers by the name under which terms read them


STEP_TIME = "step_time"  # Buffer of the time of a step [s], one number


@BUFFERS.buffer(unit="m")
def previous_distance(target_position: Tensor, robot_position: Tensor) -> Tensor:
    """Return the distance to the target one step before, or at the reset, (E,)."""
    return (target_position - robot_position).norm(dim=-1)


@BUFFERS.buffer(unit="m")
def previous_clearance(robot_clearance: Tensor) -> Tensor:
    """Return the clearance of the previous step, or at the reset [m], (E,)."""
    return robot_clearance.clone()


@BUFFERS.buffer(shape=(3,), unit="m", frame="world")
def previous_position(robot_position: Tensor) -> Tensor:
    """Return the position one step before, or at the reset, (E, 3)."""
    return robot_position.clone()


@BUFFERS.buffer(shape=(3,), unit="m/s", frame="world")
def previous_relative_velocity(robot_linvel: Tensor, target_velocity: Tensor) -> Tensor:
    """Return the velocity relative to the target one step before, or at the reset, (E, 3)."""
    return robot_linvel - target_velocity


@BUFFERS.buffer(shape=("V",))
def policy_action(policy_action: Tensor, begun: Tensor) -> Tensor:
    """Return the policy's last action, before transform, delay and filter; 0 at the start of an episode, (E, V)."""
    return torch.where(begun.unsqueeze(-1), 0.0, policy_action)


@BUFFERS.buffer(unit="m")
def previous_way(target_position: Tensor, target_orientation: Tensor, robot_position: Tensor) -> Tensor:
    """Return the way to the next gate of a track one step before, or at the reset, (E,): see ``way.gate_path_length``."""
    return gate_path_length(target_position, target_orientation, robot_position)


BUFFERS.accept_plugins(buffer=instance_converter("aerial_gym.task.values:Buffer"))


class Values(Mapping[str, Tensor]):
    """Tensors by name, with buffers made at their first use; ``print(values.own)`` shows those of the task."""

    def __init__(
        self, gtd: GlobalTensorDictionary, *, sizes: Mapping[str, int], makers: Mapping[str, Callable[..., Tensor]],
        graph: GradientGraph | None = None, around: VehicleInputs | None = None,
    ) -> None:  # fmt: skip
        """Take the simulation's dictionary, the ``graph`` of values with gradients, and what is ``around`` a vehicle, if any.

        ``makers`` declare buffers on demand, by their name, in which whole numbers may stand as ``{rows}``. They are called
        with these values, the reader's name, and the numbers by name.
        """
        self.gtd, self._makers, self.graph, self._around = gtd, makers, graph, around
        self.own = GlobalTensorDictionary(device=gtd.device, sizes=sizes)  # Buffers of the task
        self.updates: dict[str, BoundTerm] = {}  # Updates of buffers after a step, by name, in the order of computation
        self.measured: set[str] = set()
        """Buffers with a row for each environment that makers gave: kernels measure what they hold."""

    def declare(
        self, key: str, shape: tuple[int | str, ...] = (), *, dtype: torch.dtype = torch.float32, unit: str = "-",
        frame: str = "-", meaning: str, view: Tensor | None = None, rows: bool = True,
    ) -> Tensor:  # fmt: skip
        """Declare a buffer of the task, with a row of ``shape`` for each environment (``rows``); return it."""
        if key in self.gtd:
            raise DuplicateNameError(f"task buffer {key!r}: the GTD has a key of that name. Choose another one")
        whole = ("E", *shape) if rows else shape
        spec = TensorSpec(key=key, shape=whole, dtype=dtype, unit=unit, frame=frame, owner="task", meaning=meaning)
        return self.own.declare(spec, view=view)

    def find(self, name: str, reader: str) -> Tensor:
        """Return the GTD key or task buffer ``name``; a buffer is declared at its first use. ``reader`` is named in errors."""
        if name in self.gtd:
            return self.gtd.plain(name)
        if name in self.own:
            return self.own[name]
        for template, make in self._makers.items():
            numbers = numbers_in_name(name, template)
            if numbers is not None:
                made = make(self, reader, **numbers)
                self.measured |= {name} if made.ndim else set()
                return made
        if name in BUFFERS:
            return self._make_registered_buffer(name)
        made = None if self._around is None else self._around.find(name, self, reader)
        if made is not None:
            return made
        known = sorted({*self.gtd, *self.own, *self._makers, *BUFFERS})
        raise UnknownNameError(
            f"{reader} reads {name!r}, which is neither a key of the GTD nor a task buffer."
            f"{suggest_name(name, known)} Known: {', '.join(known)}"
        )

    def _make_registered_buffer(self, name: str) -> Tensor:
        entry = BUFFERS.get(name)
        try:
            made = self.declare(name, entry.shape, unit=entry.unit, frame=entry.frame, meaning=entry.summary)
        except ShapeError as error:
            raise ShapeError(f"{entry.label}: shape = {entry.shape!r}: {error}") from None
        update = bind_term(entry.term, {}, f"task buffer {name!r}")
        values = self.term_inputs(update)
        self.updates[name] = update
        letters = f"of its declared shape ({', '.join(map(str, ('E', *entry.shape)))})"
        check_result(entry.label, call_term(replace(update, label=entry.label), values), tuple(made.shape), letters)
        return made

    def term_inputs(self, *terms: BoundTerm) -> dict[str, Tensor]:
        """Return the inputs of terms, by name."""
        return {name: self.find(name, term.label) for term in terms for name in term.reads}

    def __getitem__(self, name: str) -> Tensor:
        return self.gtd.plain(name) if name in self.gtd else self.own[name]

    def __iter__(self) -> Iterator[str]:
        return iter({**self.gtd, **self.own})

    def __len__(self) -> int:
        return len(self.gtd) + len(self.own)


def numbers_in_name(name: str, template: str) -> dict[str, int] | None:
    """Return the whole numbers of a name by a template such as ``"nearest_in_{rows}x{columns}_cells"``. None if it does
    not."""
    matches = re.fullmatch(re.sub(r"\{(\w+)\}", r"(?P<\1>[1-9][0-9]*)", template), name)
    return None if matches is None else {key: int(number) for key, number in matches.groupdict().items()}
