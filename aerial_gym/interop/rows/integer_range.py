"""Ranges of the integers of a trace: whether unsigned arithmetic in 32 bits gives the same results as int64.

Random draws compute modulo 2^32 in int64, because torch has no unsigned arithmetic. A GPU needs several instructions for
64 bits.
"""

from collections.abc import Sequence

import torch

from aerial_gym.interop.rows.row_trace import Scalar, Trace

MODULUS = 1 << 32


def fits_32_bits(trace: Trace, needed: Sequence[int]) -> bool:
    """Return whether the int64 scalars can be computed modulo 2^32: each is below it, or only its lower bits are read.

    Inputs of int64 are random states, which have 32 bits.
    """
    bounds: dict[int, int | None] = {}  # largest value of a scalar; None if only its lower bits are right
    for n in needed:
        scalar = trace.scalars[n]
        given = [] if scalar.kind in ("input", "shared", "constant") else [int(a) for a in scalar.args]
        if any(bounds.get(a, 0) is None for a in given) and scalar.kind not in ("add", "mul", "bit_and", "bit_xor"):
            return False
        if scalar.dtype == torch.int64:
            if scalar.kind == "cast" and trace.scalars[given[0]].dtype != torch.int32:
                return False
            bounds[n] = _bound(
                scalar, [bounds.get(a) for a in given], [trace.scalars[a].kind == "constant" for a in given]
            )
    return True


def _bound(scalar: Scalar, given: list[int | None], fixed: list[bool]) -> int | None:
    """Return the largest value of a scalar >= 0; None from 2^32 on, or if it is unknown.

    Args:
        given: Bounds of its arguments.
        fixed: Whether they are constants.
    """
    if scalar.kind in ("input", "shared"):
        return MODULUS - 1
    if scalar.kind == "constant":
        return int(scalar.args[0]) if 0 <= scalar.args[0] < MODULUS else None
    known = [bound for bound in given if bound is not None]
    if scalar.kind == "bit_and" and known:
        return min(known)
    if len(known) < len(given) or not known:
        return None
    match scalar.kind:
        case "bit_xor":
            return (1 << max(bound.bit_length() for bound in known)) - 1
        case "shift_right":
            return known[0] >> known[1] if fixed[1] else known[0]
        case "add" | "mul":
            whole = known[0] + known[1] if scalar.kind == "add" else known[0] * known[1]
            return whole if whole < MODULUS else None
    return None
