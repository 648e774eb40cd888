"""Random expression graphs of the operations that row kernels support, as pure torch functions of rows.

Inputs of a graph are a number (E,), a vector (E, 3) and a matrix (E, 3, 3) within ±2. Each operation is continuous where it
is applied, or chooses by inputs alone, so that rounding never selects another branch. Letters: E rows.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from torch import Tensor

SHAPES = ((), (3,), (3, 3))

Operation = Callable[..., Tensor]


def squash(a: Tensor) -> Tensor:
    """Return the value within ±2, so that no graph grows beyond the range of float32."""
    return 2.0 * torch.tanh(0.5 * a)


ONE: dict[str, Operation] = {
    "neg": torch.neg,
    "abs": lambda a: (a + 0.1).abs(),
    "sqrt": lambda a: (a * a + 0.3).sqrt(),
    "rsqrt": lambda a: (a * a + 0.3).rsqrt(),
    "reciprocal": lambda a: (a * a + 0.5).reciprocal(),
    "exp": lambda a: (0.5 * squash(a)).exp(),
    "log": lambda a: (a * a + 0.5).log(),
    "sin": torch.sin,
    "cos": torch.cos,
    "tan": lambda a: (0.5 * squash(a)).tan(),
    "atan": torch.atan,
    "asin": lambda a: (0.4 * squash(a)).asin(),
    "acos": lambda a: (0.4 * squash(a)).acos(),
    "sinh": lambda a: squash(a).sinh(),
    "cosh": lambda a: squash(a).cosh(),
    "tanh": torch.tanh,
    "sigmoid": torch.sigmoid,
    "square": torch.square,
    "cube": lambda a: squash(a) ** 3,
    "root": lambda a: (a * a + 0.3) ** 0.5,
    "power": lambda a: (a * a + 0.3) ** 1.7,
    "relu": lambda a: (a + 0.05).relu(),
    "clamp": lambda a: a.clamp(-0.7, 0.9),
    "clamp_min": lambda a: a.clamp_min(-0.3),
    "clamp_max": lambda a: a.clamp_max(0.4),
    "rsub": lambda a: 1.0 - a,
    "scale": lambda a: 0.5 * a + 0.25,
    "quarter": lambda a: a / 4.0,
    "zeros": lambda a: a + torch.zeros_like(a),
    "ones": lambda a: a * torch.ones_like(a),
    "full": lambda a: a - torch.full_like(a, 0.5),
    "nan_to_num": torch.nan_to_num,
}
"""Operations on one tensor of any shape."""

TWO: dict[str, Operation] = {
    "add": torch.add,
    "sub": torch.sub,
    "alpha": lambda a, b: torch.add(a, b, alpha=0.5),
    "mul": torch.mul,
    "div": lambda a, b: a / (b * b + 0.5),
    "over_root": lambda a, b: a / (b * b + 0.3).sqrt(),
    "minimum": torch.minimum,
    "maximum": torch.maximum,
    "atan2": lambda a, b: torch.atan2(a, b * b + 0.3),
}
"""Operations on two tensors of equal shape."""

VECTOR: dict[str, Operation] = {
    "sum": lambda v: v.sum(-1),
    "mean": lambda v: v.mean(-1),
    "prod": lambda v: squash(v).prod(-1),
    "amin": lambda v: v.amin(-1),
    "amax": lambda v: v.amax(-1),
    "norm": lambda v: (v * v + 0.1).norm(dim=-1),
    "first": lambda v: v[..., 0],
}
"""From the last axis to one number."""


def random_function(rng: np.random.Generator, *, length: int = 12, smooth: bool = False) -> Callable[..., Tensor]:
    """Return a function of number (E,), vector (E, 3) and matrix (E, 3, 3) to a vector (E, 3).

    Args:
        length: Number of operations.
        smooth: Whether operations with kinks are left out.
    """
    kinks = (
        {"abs", "relu", "clamp", "clamp_min", "clamp_max", "minimum", "maximum", "amin", "amax"} if smooth else set()
    )
    unary, binary = ([f for name, f in table.items() if name not in kinks] for table in (ONE, TWO))
    vectors = [f for name, f in VECTOR.items() if name not in kinks]
    steps: list[Callable[[dict[int, list[Tensor]]], None]] = []
    for _ in range(length):
        kind, dims, picks = int(rng.integers(8)), int(rng.integers(3)), rng.random(4)
        one, two, vector = (table[int(rng.integers(len(table)))] for table in (unary, binary, vectors))
        steps.append(partial(_step, kind, dims, picks, (one, two, vector)))

    def function(number: Tensor, vector: Tensor, matrix: Tensor) -> Tensor:
        pool = {0: [number], 1: [vector], 2: [matrix]}
        for step in steps:
            step(pool)
        ends = pool[1][-1] + pool[0][-1].unsqueeze(-1) + pool[2][-1].sum(-1)
        return squash(ends)

    return function


def _step(
    kind: int, dims: int, picks: np.ndarray, tables: tuple[Operation, ...], pool: dict[int, list[Tensor]]
) -> None:
    """Apply one operation and append its result to the pool of its number of dimensions."""

    def pick(dims: int, place: int) -> Tensor:
        return pool[dims][int(picks[place] * len(pool[dims]))]

    one, two, reduce = tables
    match kind:
        case 0 | 1:
            pool[dims].append(squash(one(pick(dims, 0))))
        case 2 | 3:
            pool[dims].append(squash(two(pick(dims, 0), pick(dims, 1))))
        case 4:
            pool[max(dims - 1, 0)].append(squash(reduce(pick(max(dims, 1), 0))))
        case 5:
            mask = pool[dims][0] < 0.25 if dims else pool[0][0] >= 0.0
            pool[dims].append(torch.where(mask, pick(dims, 0), pick(dims, 1)))
        case 6:
            crossed = torch.linalg.cross(pick(1, 0), pick(1, 1), dim=-1)
            product = torch.bmm(pick(2, 2), crossed.unsqueeze(-1)).squeeze(-1)
            pool[1].append(squash(product + torch.cat((pick(1, 3)[:, 1:], pick(0, 0).unsqueeze(-1)), dim=-1).flip(-1)))
        case 7:
            rows = torch.stack((pick(1, 0), pick(1, 1).roll(1, dims=-1), pick(1, 2)), dim=1)
            pool[2].append(squash(rows.transpose(1, 2) + torch.diag_embed(pick(1, 3))))
