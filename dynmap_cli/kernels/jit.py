"""How kernels are compiled: serial, GIL released, cached on disk, signatures left lazy."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba
from numba.core import event

P = ParamSpec("P")
R = TypeVar("R")

# Many processes that share one cache can crash; DYNMAP_NUMBA_CACHE=0 keeps each to itself.
CACHE = os.environ.get("DYNMAP_NUMBA_CACHE", "1") == "1"


def _keep_apart_by_source() -> None:
    """Give each state of this folder a cache of its own.

    numba sees when the file of a kernel changed, but not when one of the kernels did that it calls from
    another file; it would run on with the old code.
    """
    folder = Path(__file__).parent
    sources = b"".join(path.read_bytes() for path in sorted(folder.glob("*.py")))
    config: Any = numba.config
    base = Path(config.CACHE_DIR or folder / "__pycache__")
    config.CACHE_DIR = str(base / hashlib.sha256(sources).hexdigest()[:16])


_keep_apart_by_source()


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a serial kernel; keeps its signature for the type checker."""
    return cast(
        "Callable[P, R]",
        numba.njit(cache=CACHE, nogil=True, error_model="numpy")(function),
    )


class _FirstCompilation(event.Listener):
    """Calls a function before the first kernel that has to be compiled; those from the cache do not count."""

    def __init__(self, function: Callable[[], None]) -> None:
        self._function: Callable[[], None] | None = function

    def on_start(self, event: Any) -> None:
        """Call it the first time."""
        function, self._function = self._function, None
        if function is not None:
            function()

    def on_end(self, event: Any) -> None:
        """Leave the end of a compilation as it is."""


def before_first_compilation(function: Callable[[], None]) -> None:
    """Have a function called once in this process, when a kernel is compiled."""
    events: Any = event
    events.register("numba:compile", _FirstCompilation(function))
