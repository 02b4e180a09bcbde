"""How kernels are compiled: serial, GIL released, cached on disk, signatures left lazy."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

# Many processes that share one cache can crash; DYNMAP_NUMBA_CACHE=0 keeps each to itself.
CACHE = os.environ.get("DYNMAP_NUMBA_CACHE", "1") == "1"


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a serial kernel; keeps its signature for the type checker."""
    return cast(
        "Callable[P, R]",
        numba.njit(cache=CACHE, nogil=True, error_model="numpy")(function),
    )
