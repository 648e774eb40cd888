"""Tolerance rule for equality of an exported file and the policy in torch.

For each output, on the same inputs:

    error <= FACTOR * (rounding + 2**-23 * span)

- ``error``: largest distance of the file from torch in float64;
- ``rounding``: the same of torch in float32, the policy that was trained;
- ``span``: range of the output in float64; ``2**-23`` of it is one unit in the last place of float32.

So the limit has the unit of the output and follows its conditioning. Inputs that are not finite must give NaN
(``aerial_gym.export.module``); a number there is an infinite error.
Letters: B rows, N outputs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isnan, nan

import torch
from torch import Tensor

FACTOR = 10.0
"""Two evaluations in float32 differ in the order of their sums and in ``exp`` and ``tanh``. The error was
0.75 to 1.8 times the rounding over C files of 16 drawn policies, and at most 1.8 times over ONNX files of 36."""

UNIT = 2.0**-23  # Relative distance of neighbouring float32 numbers


@dataclass(frozen=True)
class Agreement:
    """The output of a file that uses most of its limit."""

    output: str  # Its name
    error: float  # Largest distance from torch in float64, in the unit of the output
    rounding: float  # Largest distance of torch in float32 from torch in float64
    span: float  # Range of the output

    @property
    def limit(self) -> float:
        """Largest error that passes."""
        return FACTOR * (self.rounding + UNIT * self.span)

    @property
    def holds(self) -> bool:
        """Whether the file agrees with the policy; NaN errors fail."""
        return self.error <= self.limit


class Comparison:
    """Comparison of a file's outputs with torch, batch by batch."""

    def __init__(self, names: Sequence[str]) -> None:
        zeros = torch.zeros(len(names), dtype=torch.float64)
        self._names = list(names)
        self._error, self._rounding, self._difference = zeros, zeros, zeros
        self._low, self._high = zeros + inf, zeros - inf

    def add(self, exact: Tensor, rounded: Tensor, exported: Tensor) -> None:
        """Count outputs (B, N) of torch in float64, of torch in float32, and of the file."""
        self._low, self._high = self._low.minimum(exact.amin(0)), self._high.maximum(exact.amax(0))
        self._error = self._error.maximum((exported.double() - exact).abs().amax(0))
        self._rounding = self._rounding.maximum((rounded.double() - exact).abs().amax(0))
        self._difference = self._difference.maximum((exported - rounded).double().abs().amax(0))

    def add_not_finite(self, exported: Tensor) -> None:
        """Count outputs (B, N) of the file for inputs that are not finite."""
        self._error = torch.where(exported.isnan().all(0), self._error, inf)

    @property
    def largest_difference(self) -> float:
        """Largest distance of the file from torch in float32, over all outputs."""
        return float(self._difference.amax())

    @property
    def worst(self) -> Agreement:
        """The output that uses most of its limit."""
        numbers = (self._error.tolist(), self._rounding.tolist(), (self._high - self._low).tolist())
        return max((Agreement(*each) for each in zip(self._names, *numbers, strict=True)), key=_share_of_limit)


def inputs_not_finite(width: int, entries: Sequence[int]) -> Tensor:
    """Return zero inputs (3 K, O), each with one of K entries set to NaN, infinity or minus infinity."""
    places = torch.nn.functional.one_hot(torch.tensor(entries), width).bool()
    return torch.cat([torch.where(places, value, 0.0) for value in (nan, inf, -inf)])


def _share_of_limit(each: Agreement) -> float:
    """Return the share of its limit that an output uses; infinite for an error without a limit, or NaN."""
    if each.error == 0.0:
        return 0.0
    share = each.error / each.limit if each.limit > 0.0 else inf
    return inf if isnan(share) else share
