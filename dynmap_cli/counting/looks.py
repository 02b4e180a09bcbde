"""Looks: the scans of a few seconds are one observation of a place, however many beams they send there.

The hit share of beams cannot tell a person who stands for a while from glass: both reflect a part of all beams. Looks
can. Glass is never seen free, for in each look some beams come back; where somebody stood, the looks before and after
saw beams cross the place and end well behind it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import F64, I8, I32, I64
from dynmap_cli.counting.evidence import Evidence, EvidenceParams, SurfaceCells, surface_cells
from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.progress import Tick, no_tick

_LOOKS_AHEAD = 2


@dataclass(frozen=True, slots=True)
class Looks:
    """In how many looks each cell was seen occupied, and free; the others said nothing of it.

    Attributes
    ----------
    surface : SurfaceCells
        The cells.
    occupied, free : (n,) int64
    n_looks : int
    """

    surface: SurfaceCells
    occupied: I64
    free: I64
    n_looks: int


@dataclass(frozen=True, slots=True)
class Watch:
    """Looks within a few minutes of one recording: what changes in them was seen to move, or nearly so.

    Attributes
    ----------
    scans : slice
    counts : (n_parts, 2, n) unsigned integers
        In how many looks of each part of this time each surface cell was seen occupied, and free.
    """

    scans: slice
    counts: NDArray[Any]

    @property
    def occupied(self) -> I32:
        """(n,) in how many of these looks each surface cell was seen so."""
        return np.asarray(self.counts[:, 0].sum(axis=0, dtype=np.int32))

    @property
    def free(self) -> I32:
        """(n,) likewise."""
        return np.asarray(self.counts[:, 1].sum(axis=0, dtype=np.int32))


@dataclass(frozen=True, slots=True)
class Watched:
    """What all looks together saw, and those of each watch.

    Attributes
    ----------
    looks : Looks
    hits, crossed : (n,) float64
        Beams that ended in each surface cell, and length of those that crossed its surface, cells.
    watches : tuple of Watch
    """

    looks: Looks
    hits: F64
    crossed: F64
    watches: tuple[Watch, ...]


@dataclass(frozen=True, slots=True)
class Look:
    """What one look saw: numbers, states, hits and crossed lengths of the cells that it saw, each (m,)."""

    scans: slice
    seen: I64
    states: I8
    hits: F64
    crossed: F64


def time_windows(log: ScanLog, window_s: float) -> list[slice]:
    """Runs of scans of one recording that lie in the same window; windows count from its first scan."""
    if log.n_scans == 0:
        return []
    window_ns = round(window_s * 1e9)
    starts = np.flatnonzero(np.diff(log.recording_index, prepend=-1))
    first = np.repeat(log.stamps_ns[starts], np.diff(starts, append=log.n_scans))
    number = (log.stamps_ns - first) // window_ns
    cuts = np.flatnonzero((np.diff(number) != 0) | (np.diff(log.recording_index) != 0)) + 1
    edges = [0, *cuts.tolist(), log.n_scans]
    return [slice(first, last) for first, last in pairwise(edges)]


def judged_looks(
    log: ScanLog,
    poses: F64,
    windows: Sequence[slice],
    surface: SurfaceCells,
    params: EvidenceParams,
    on_look: Tick = no_tick,
    *,
    threads: int = 1,
) -> Iterator[Look]:
    """Judge the surface cells in one look after the other; threads work on the next ones meanwhile."""
    spare: SimpleQueue[Evidence] = SimpleQueue()
    for _ in range(threads):
        spare.put(Evidence(surface, params))

    def judge(window: slice) -> Look:
        evidence = spare.get()
        evidence.add(log.select(window), poses[window])
        seen, states = evidence.judge()
        look = Look(window, seen, states, evidence.hits[seen], evidence.crossed[seen])
        evidence.clear()
        spare.put(evidence)
        return look

    waiting: deque[Future[Look]] = deque()
    with ThreadPoolExecutor(max_workers=threads) as pool:
        for window in windows:
            waiting.append(pool.submit(judge, window))
            if len(waiting) > _LOOKS_AHEAD * threads:
                yield waiting.popleft().result()
                on_look()
        while waiting:
            yield waiting.popleft().result()
            on_look()


def count_watches(
    log: ScanLog,
    poses: F64,
    frame: GridFrame,
    look_s: float,
    watch_s: float,
    params: EvidenceParams,
    *,
    threads: int = 1,
) -> Watched:
    """Count looks and beams over everything, and looks in each watch of *watch_s*; watches overlap by half.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot; scans with NaN are left out.
    frame : GridFrame
    look_s, watch_s : float
        Without watches if watch_s is 0.
    params : EvidenceParams
    threads : int
    """
    windows = time_windows(log, look_s)
    surface = surface_cells(log, poses, frame, windows, params)
    halves = time_windows(log, watch_s / 2.0) if watch_s else [slice(0, log.n_scans)]
    starts = np.array([half.start for half in halves])
    half_of = np.searchsorted(starts, [window.start for window in windows], side="right") - 1
    most = int(np.bincount(half_of).max(initial=0))
    counts = np.zeros((len(halves), 2, surface.cells.shape[0]), dtype=np.min_scalar_type(most))
    hits, crossed = (np.zeros(surface.cells.shape[0]) for _ in range(2))
    looks = judged_looks(log, poses, windows, surface, params, threads=threads)
    for half, look in zip(half_of, looks, strict=True):
        counts[half, 0, look.seen] += look.states == OCCUPIED
        counts[half, 1, look.seen] += look.states == FREE
        hits[look.seen] += look.hits
        crossed[look.seen] += look.crossed
    occupied, free = counts.sum(axis=0, dtype=np.int64)
    watches = []
    for first, last in _pairs(log, halves, watch_s) if watch_s else ():
        scans = slice(halves[first].start, halves[last].stop)
        watches.append(Watch(scans, counts[first : last + 1]))
    return Watched(Looks(surface, occupied, free, len(windows)), hits, crossed, tuple(watches))


def _pairs(log: ScanLog, halves: Sequence[slice], watch_s: float) -> Iterator[tuple[int, int]]:
    """First and last half of each watch: two that follow one another, and halves with none beside them alone."""
    is_followed = False
    for k, half in enumerate(halves):
        was_followed, is_followed = is_followed, False
        if k + 1 < len(halves):
            after = halves[k + 1]
            is_followed = bool(
                log.recording_index[half.start] == log.recording_index[after.start]
                and log.stamps_ns[after.start] - log.stamps_ns[half.start] < round(watch_s * 1e9)
            )
        if is_followed:
            yield k, k + 1
        elif not was_followed:
            yield k, k
