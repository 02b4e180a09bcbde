"""The one place that draws bars on a terminal, or plain lines elsewhere; everything goes to stderr."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

_log = logging.getLogger(__name__)
_SECONDS_BETWEEN_LINES = 10.0


class Tick(Protocol):
    """Called by the work with the number of units done since the last call."""

    def __call__(self, units: int = 1, /) -> None:
        """Count *units* as done."""


def no_tick(_units: int = 1, /) -> None:
    """Count nothing."""


@contextmanager
def progress(label: str, total: int, unit: str) -> Iterator[Tick]:
    """Show how far a piece of work is, with rate and time left; yields the function to call."""
    if not _log.isEnabledFor(logging.INFO):
        yield no_tick
    elif sys.stderr.isatty():
        from tqdm import tqdm

        with tqdm(total=total, desc=label, unit=f" {unit}", leave=False, file=sys.stderr) as bar:

            def tick(units: int = 1, /) -> None:
                bar.update(units)

            yield tick
    else:
        yield _plain_lines(label, total, unit)


def _plain_lines(label: str, total: int, unit: str) -> Tick:
    """Log a line every ten seconds; the rate is that from the first unit on, which may have waited for kernels."""
    state = {"done": 0, "first": 0, "started": -1.0, "next_line": 0.0}

    def tick(units: int = 1, /) -> None:
        state["done"] += units
        now = time.monotonic()
        if state["started"] < 0.0:
            state.update(first=state["done"], started=now, next_line=now + _SECONDS_BETWEEN_LINES)
        if now < state["next_line"]:
            return
        state["next_line"] = now + _SECONDS_BETWEEN_LINES
        rate = (state["done"] - state["first"]) / (now - state["started"])
        left = max(total - state["done"], 0) / max(rate, 1e-9)
        _log.info(
            "%s: %d of %d %s, %.0f per second, %.0f s left", label, state["done"], total, unit, rate, left
        )

    return tick
