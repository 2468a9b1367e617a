"""Compilation of numerical kernels to machine code."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Compile to machine code that runs without the interpreter lock and is cached on disk.

    The cache only notices changes in the function's own file: a compiled function must not call
    one in another module. Without a writable directory, there is no cache.
    """
    jitted: Callable[Parameters, Result]
    try:
        jitted = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:
        jitted = numba.njit(nogil=True, error_model="numpy")(function)
    return jitted
