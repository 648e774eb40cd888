"""Checks of the shape and dtype that terms return. Letters: E environments."""

from collections.abc import Mapping

import torch
from torch import Tensor

from aerial_gym.errors import ConfigError
from aerial_gym.task.terms.term import BoundTerm


@torch.no_grad()
def term_width(term: BoundTerm, values: Mapping[str, Tensor], *, rows: int, width: int | None) -> int:
    """Return the entries that an observation term returns for each environment, found by calling it once.

    Args:
        width: Declared by the term; None without a declaration.

    Raises:
        ConfigError: If it returns another shape or whole numbers.
    """
    value = _call(term, values)
    if width is None:
        if not isinstance(value, Tensor) or value.dim() != 2 or value.shape[0] != rows:
            _check(term.label, value, (rows, -1), "(E, W)")
        width = value.shape[1]
    _check(term.label, value, (rows, width), "(E, width)")
    return width


@torch.no_grad()
def check_number(term: BoundTerm, values: Mapping[str, Tensor], *, rows: int) -> None:
    """Raise ``ConfigError`` unless a term returns a number for each row: (E, 1) would be spread to (E, E) in silence."""
    _check(term.label, _call(term, values), (rows,), "(E,)")


@torch.no_grad()
def check_truth(term: BoundTerm, values: Mapping[str, Tensor], *, rows: int) -> None:
    """Raise ``ConfigError`` unless a term returns a truth value for each environment."""
    value = _call(term, values)
    if not isinstance(value, Tensor) or tuple(value.shape) != (rows,) or value.dtype != torch.bool:
        actual = f"{tuple(value.shape)} {value.dtype}" if isinstance(value, Tensor) else f"a {type(value).__name__}"
        raise ConfigError(f"{term.label}: returns {actual}, needs (E,) = {(rows,)} of torch.bool")


def _call(term: BoundTerm, values: Mapping[str, Tensor]) -> Tensor:
    try:
        return term.evaluate(values)
    except Exception as error:
        reason = (str(error).strip().splitlines() or [""])[0]
        raise ConfigError(f"{term.label}: cannot be computed ({type(error).__name__}: {reason})") from error


def _check(label: str, value: object, expected: tuple[int, ...], letters: str) -> None:
    if not isinstance(value, Tensor):
        raise ConfigError(f"{label}: returns a {type(value).__name__}, needs a tensor {letters}")
    if tuple(value.shape) != expected or not value.is_floating_point():
        raise ConfigError(
            f"{label}: returns {tuple(value.shape)} {value.dtype}, needs {letters} = {expected} of floating point numbers"
        )
