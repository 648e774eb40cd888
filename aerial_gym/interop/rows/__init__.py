"""Pure torch functions of rows, run as one Warp kernel: traced once, without torch's compiler and its long start.

``tracing.py`` records what a function does to one row, ``source.py`` writes that as Warp code, ``function.py`` launches it.
"""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.interop.rows.function import Made, RowFunction, RowWork
    from aerial_gym.interop.rows.gradient import DifferentiableRows
    from aerial_gym.interop.rows.masked import MaskedRows
    from aerial_gym.interop.rows.tracing import UntraceableError, trace

__all__ = ["DifferentiableRows", "Made", "MaskedRows", "RowFunction", "RowWork", "UntraceableError", "trace"]

__getattr__, __dir__ = exports(__name__, __file__)
