"""A term: a pure function whose arguments say what it reads and which numbers it takes.

``def near(target_position: Tensor, robot_position: Tensor, *, width: float) -> Tensor`` reads two tensors, which are keys of
the GTD or task buffers, (E, ...), and has one parameter. The signature is the whole interface of a term.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from inspect import Parameter, signature
from typing import Any, TypeVar, cast, get_type_hints

import torch
from torch import Tensor

from aerial_gym.config.loader import convert
from aerial_gym.errors import ConfigError, suggest_name
from aerial_gym.registry import Registry

Function = TypeVar("Function", bound=Callable[..., Tensor])

ACTION = -1  # Width of a term that has as many entries as a command to the controller


@dataclass(frozen=True, kw_only=True)
class Term:
    """A registered function with its interface."""

    name: str
    value: Callable[..., Tensor]  # Function of its inputs, in order, and of its parameters by name
    width: int | None = None  # Number of entries per environment, ``ACTION``, or None if only a call determines it
    command: tuple[str, ...] | None = None  # Required controller command (``Law.action``); None fits all

    inputs: tuple[str, ...] | None = None  # Names of its input tensors; those of the arguments if not given
    text: str = ""  # One line about it; that of the function's docstring if not given
    named: Mapping[str, str] = field(default_factory=dict)
    """Names of tensors that follow from its numbers, by the argument: ``"nearest_in_{rows}x{columns}_cells"``."""

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the input tensors, with the names of ``named`` where given."""
        parameters = _signature_parameters(self.value)
        names = self.inputs or (name for name, each in parameters if each.kind is not Parameter.KEYWORD_ONLY)
        return tuple(self.named.get(name, name) for name in names)

    @property
    def summary(self) -> str:
        """One line about it."""
        return self.text or (self.value.__doc__ or "").partition("\n")[0]


@dataclass(frozen=True, kw_only=True)
class BoundTerm:
    """A term with its numbers, as a task uses it."""

    label: str  # Name in messages, unique within the task
    term: Term
    params: Mapping[str, Any]
    reads: tuple[str, ...] = field(default=())

    def evaluate(self, values: Mapping[str, Tensor]) -> Tensor:
        """Return the term's value; a value already stored under its label is reused."""
        ready = values.get(self.label)
        if ready is not None:
            return ready
        return self.term.value(*(values[name] for name in self.reads), **self.params)


def bind_term(term: Term, params: Mapping[str, object], label: str) -> BoundTerm:
    """Return a term with its numbers; raise ``ConfigError`` if a number is missing, unknown or of another kind."""
    given = check_params(term.value, params, label)
    numbers = {name: each.default for name, each in _signature_parameters(term.value)} | given if term.named else {}
    reads = tuple(name.format(**numbers) if name in term.named.values() else name for name in term.reads)
    return BoundTerm(label=label, term=term, params=given, reads=reads)


def check_params(function: Callable[..., object], params: Mapping[str, object], label: str) -> dict[str, Any]:
    """Return the keyword arguments of a function, converted to its type hints; ``label`` is the prefix of errors."""
    known = {name: each for name, each in _signature_parameters(function) if each.kind is Parameter.KEYWORD_ONLY}
    takes = ", ".join(known) or "none"
    unknown = [name for name in params if name not in known]
    faults = [f"{label}: no parameter {name!r}.{suggest_name(name, known)} It takes {takes}" for name in unknown]
    missing = [name for name, each in known.items() if each.default is Parameter.empty and name not in params]
    if faults := [*faults, *(f"{label}: parameter {name!r} is missing. It takes {takes}" for name in missing)]:
        raise ConfigError(*faults)
    whole = function.func if isinstance(function, partial) else function
    hints = get_type_hints(whole.__init__ if isinstance(whole, type) else whole)
    return {name: convert(hints.get(name, object), value, f"{label}: {name}") for name, value in params.items()}


def _signature_parameters(function: Callable[..., object]) -> Iterator[tuple[str, Parameter]]:
    for name, each in signature(function).parameters.items():
        if each.kind in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD):
            raise ConfigError(f"term {name!r}: *{name} hides inputs and parameters. Name each of them")
        yield name, each


@torch.no_grad()
def call_term(term: BoundTerm, values: Mapping[str, Tensor]) -> Tensor:
    """Return the value of a term; raise ``ConfigError`` if it cannot be computed."""
    try:
        return term.evaluate(values)
    except Exception as error:
        reason = (str(error).strip().splitlines() or [""])[0]
        raise ConfigError(f"{term.label}: cannot be computed ({type(error).__name__}: {reason})") from error


def check_result(label: str, value: object, expected: tuple[int, ...], letters: str, *, truth: bool = False) -> None:
    """Raise ``ConfigError`` unless a value is a tensor of a shape, of truth values or else of floating point numbers."""
    needs = f"needs a tensor {letters} = {expected} of {'torch.bool' if truth else 'floating point numbers'}"
    if not isinstance(value, Tensor):
        raise ConfigError(f"{label}: returns a {type(value).__name__}, {needs}")
    fits = value.dtype == torch.bool if truth else value.is_floating_point()
    if tuple(value.shape) != expected or not fits:
        raise ConfigError(f"{label}: returns {tuple(value.shape)} {value.dtype}, {needs}")


def term_from_function(name: str, function: object) -> Term:
    """Return the term of a function, or the term itself; raise ``ConfigError`` for anything else."""
    if not (isinstance(function, Term) or callable(function)):
        raise ConfigError(f"term {name!r}: is a {type(function).__name__}, needs a function of tensors")
    term = function if isinstance(function, Term) else Term(name=name, value=cast("Callable[..., Tensor]", function))
    _ = term.reads  # refuses a signature without names
    return term


class TermRegistry(Registry[Term]):
    """Terms of one kind by name."""

    def term(
        self, name: str | None = None, *, width: int | None = None, command: Sequence[str] | None = None,
        named: Mapping[str, str] | None = None,
    ) -> Callable[[Function], Function]:  # fmt: skip
        """Register the function below under its own name, or another one.

        Args:
            name: Under which a task asks for it; that of the function if not given.
            width: Entries per environment, where it is always the same; such a term is checked for it.
            command: Required controller command, as in ``aerial_gym.control.laws.LAWS``; None fits all.
            named: Templates of input names that depend on the term's numbers, by argument.
        """

        def add(function: Function) -> Function:
            known = name or function.__name__
            needs = None if command is None else tuple(command)
            term = Term(name=known, value=function, width=width, command=needs, named=dict(named or {}))
            self.register(known, term_from_function(known, term))
            return function

        return add
