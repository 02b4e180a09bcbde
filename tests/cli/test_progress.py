"""Progress: a bar with rate and time left on a terminal, plain lines elsewhere, nothing when quiet."""

import io
import logging
import sys
import time

import pytest

from dynmap_cli.commands.options import set_up_logging
from dynmap_cli.progress import no_tick, progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture
def stderr(monkeypatch):
    def use(stream, **options):
        monkeypatch.setattr(sys, "stderr", stream)
        set_up_logging(0, **{"quiet": False, **options})
        return stream

    yield use
    logging.getLogger("dynmap_cli").handlers.clear()


def test_plain_lines_with_rate_and_time_left(stderr, monkeypatch):
    stream = stderr(io.StringIO())
    clock = iter([30.0, 35.0, 50.0, 55.0, 61.0])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    with progress("map", 400, "scans") as tick:
        for _ in range(5):
            tick(50)
    assert stream.getvalue().splitlines() == [
        "map: 150 of 400 scans, 5 per second, 50 s left",
        "map: 250 of 400 scans, 6 per second, 23 s left",
    ]


def test_a_bar_on_a_terminal(stderr):
    stream = stderr(Terminal())
    with progress("map", 2, "scans") as tick:
        tick(2)
    assert "map:" in stream.getvalue()
    assert "scans/s" in stream.getvalue()


def test_nothing_when_quiet(stderr):
    stream = stderr(Terminal(), quiet=True)
    with progress("map", 2, "scans") as tick:
        assert tick is no_tick
        tick(2)
    assert stream.getvalue() == ""
