"""A word about the silence of the first run: its kernels are compiled."""

from __future__ import annotations

import functools
import logging

_log = logging.getLogger(__name__)


@functools.cache
def announce_compilation() -> None:
    """Have one line logged when a kernel really is compiled, and none where all come from the cache."""
    from dynmap_cli.kernels.jit import CACHE, before_first_compilation

    how_often = (
        "those that this command is the first here to need"
        if CACHE
        else "at each call, as DYNMAP_NUMBA_CACHE=0 switches the cache off"
    )
    before_first_compilation(lambda: _log.info("compiling kernels, %s: up to a minute", how_often))
