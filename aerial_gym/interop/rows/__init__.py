"""Row functions: pure torch functions of rows, traced once and run as one Warp kernel, without torch's compiler.

``tracing.py`` records the operations on one row, ``source.py`` writes them as Warp code, ``function.py`` launches the kernel.
"""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.interop.rows.function import DifferentiableRows, KernelInput, RowFunction, RowUpdate, RowWork
    from aerial_gym.interop.rows.row_trace import UntraceableError, trace

__all__ = ["DifferentiableRows", "KernelInput", "RowFunction", "RowUpdate", "RowWork", "UntraceableError", "trace"]

__getattr__, __dir__ = exports(__name__, __file__)
