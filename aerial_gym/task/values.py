"""Inputs of a task's terms by name: GTD keys and the task's own buffers.

Letters: E environments, U entries of a command, V entries of an action.
"""

import re
from collections.abc import Callable, Iterator, Mapping

import torch
from torch import Tensor

from aerial_gym.errors import DuplicateNameError, UnknownNameError, suggest_name
from aerial_gym.registry import GlobalTensorDictionary, TensorSpec
from aerial_gym.task.step.row_kernels import GradientGraph
from aerial_gym.task.terms.buffers import BUFFERS
from aerial_gym.task.terms.term import BoundTerm, bind_term


class Values(Mapping[str, Tensor]):
    """Tensors by name, with buffers made at their first use; ``print(values.own)`` shows those of the task."""

    def __init__(
        self, gtd: GlobalTensorDictionary, *, sizes: Mapping[str, int], makers: Mapping[str, Callable[..., Tensor]],
        graph: GradientGraph | None = None,
    ) -> None:  # fmt: skip
        """Take the simulation's dictionary, and the ``graph`` of values with gradients, if any.

        ``makers`` declare buffers on demand, by their name, in which whole numbers may stand as ``{rows}``. They are called
        with these values, the reader's name, and the numbers by name.
        """
        self.gtd, self._makers, self.graph = gtd, makers, graph
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
        known = sorted({*self.gtd, *self.own, *self._makers, *BUFFERS})
        raise UnknownNameError(
            f"{reader} reads {name!r}, which is neither a key of the GTD nor a task buffer."
            f"{suggest_name(name, known)} Known: {', '.join(known)}"
        )

    def _make_registered_buffer(self, name: str) -> Tensor:
        entry = BUFFERS.get(name)
        made = self.declare(name, entry.shape, unit=entry.unit, frame=entry.frame, meaning=entry.summary)
        label = f"task buffer {name!r}"
        for read in entry.term.reads:
            self.find(read, label)
        self.updates[name] = bind_term(entry.term, {}, label)
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
