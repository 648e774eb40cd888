"""Checks of the shape and dtype that terms return. Letters: E environments."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.task.terms.term import BoundTerm


def term_width(term: BoundTerm, values: Mapping[str, Tensor], *, rows: int, width: int | None) -> int:
    """Return the entries of an observation term per environment, by calling it once; ``width`` is the declared number."""
    value = call_term(term, values)
    if width is None:
        if not isinstance(value, Tensor) or value.dim() != 2 or value.shape[0] != rows:
            check_result(term.label, value, (rows, -1), "(E, W)")
        width = value.shape[1]
    check_result(term.label, value, (rows, width), "(E, width)")
    return width


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
