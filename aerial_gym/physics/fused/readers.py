"""Readers of an environment's numbers in the fused kernel: from a shared struct, or from packed rows.

Letters: E environments, R rotors, N packed numbers.
"""

import linecache
from collections.abc import Mapping
from functools import cache
from itertools import count
from typing import Any

import warp as wp

from aerial_gym.physics.fused.types import RotorTypes


@cache
def make_reader(kind: Any, height: int, width: int) -> wp.Function:
    """Return the function that reads a vector (width 0) or matrix of one environment from the packed tensor."""

    @wp.func
    def read_vector(source: wp.array2d[float], first: int, env: int) -> kind:
        value = kind()
        for i in range(wp.static(height)):
            value[i] = source[first + i, env]
        return value

    @wp.func
    def read_matrix(source: wp.array2d[float], first: int, env: int) -> kind:
        value = kind()
        for i in range(wp.static(height)):
            for j in range(wp.static(width)):
                value[i, j] = source[first + i * wp.static(width) + j, env]
        return value

    return read_matrix if width else read_vector


@wp.func
def read_symmetric(source: wp.array2d[float], first: int, env: int) -> wp.mat33:
    """Read a symmetric matrix of one environment from its ``SYMMETRIC`` entries."""
    xx, xy, xz = source[first, env], source[first + 1, env], source[first + 2, env]
    yy, yz, zz = source[first + 3, env], source[first + 4, env], source[first + 5, env]
    return wp.mat33(xx, xy, xz, xy, yy, yz, xz, yz, zz)


@cache
def make_column_reader(kind: Any, height: int, first_column: int, width: int) -> wp.Function:
    """Return the function that reads a matrix of one environment with some packed columns and zeros elsewhere."""

    @wp.func
    def read_columns(source: wp.array2d[float], first: int, env: int) -> kind:
        value = kind()
        for i in range(wp.static(height)):
            for j in range(wp.static(width)):
                value[i, wp.static(first_column) + j] = source[first + i * wp.static(width) + j, env]
        return value

    return read_columns


def make_vehicle_reader(
    types: RotorTypes, packed: Mapping[str, int], entries: Mapping[str, tuple[int, ...]]
) -> wp.Function:
    """Return the function that completes the shared vehicle with an environment's own numbers."""
    num_rotors = types.vector._length_
    few: dict[str, wp.Function] = {}
    if "inertia" in entries:
        few |= dict.fromkeys(("inertia", "inertia_inverse"), read_symmetric)
    for name in {"thrust_map", "torque_map"} & entries.keys():
        few[name] = make_column_reader(types.rows, num_rotors, 2, 1)
    return make_completion(types.vehicle, packed, few)


def make_completion(struct: Any, packed: Mapping[str, int], few: Mapping[str, wp.Function]) -> wp.Function:
    """Return ``wp.func`` (shared struct, packed tensor, environment) -> the struct with its packed fields in place.

    Args:
        packed: First row of each packed field.
        few: Readers of fields with only some packed entries.
    """
    kinds = {name: kind for name, kind in struct.cls.__annotations__.items() if name in packed}
    names: dict[str, Any] = {f"read_{n}": few[n] if n in few else _make_reader(kind) for n, kind in kinds.items()}
    lines = [f"    value.{name} = read_{name}(source, {packed[name]}, env)" for name in kinds]
    head = "def complete(shared: struct, source: wp.array2d[float], env: int) -> struct:\n    value = shared\n"
    return compile_source("complete", head + "\n".join([*lines, "    return value"]), {**names, "struct": struct})


def _make_reader(kind: Any) -> wp.Function:
    if kind is float:
        return read_number
    height, *width = kind._shape_
    return make_reader(kind, height, *(width or (0,)))


@wp.func
def read_number(source: wp.array2d[float], first: int, env: int) -> float:
    """Read one number of one environment."""
    return source[first, env]


def compile_source(name: str, code: str, names: Mapping[str, Any]) -> wp.Function:
    """Compile a source that may call ``names``, and return its ``wp.func``."""
    file = f"<{__name__} {next(_number)}>"
    linecache.cache[file] = (len(code), None, code.splitlines(keepends=True), file)  # Warp reads the source here
    namespace = {"wp": wp, "__name__": __name__, **names}
    exec(compile(code, file, "exec"), namespace)
    return wp.func(namespace[name])


_number = count()
