"""Give freed memory of the process back to the system."""

import ctypes
from collections.abc import Callable
from functools import cache


def give_back_memory() -> None:
    """Give freed memory back to the system, if the C library (glibc) supports it.

    Fits keep a few long arrays and free many around them. The process retains these gaps, which rarely fit later requests.
    Measured on 13 minutes of flight: 0.1 to 0.25 GB per fit, in 10 ms.
    """
    if (trim := _malloc_trim()) is not None:
        trim(0)


@cache
def _malloc_trim() -> Callable[[int], int] | None:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (OSError, AttributeError, TypeError):  # no glibc
        return None
