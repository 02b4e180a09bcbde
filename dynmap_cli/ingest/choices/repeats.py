"""Recordings of a recording that was played again and again (`ros2 bag play --loop`): each message is used once.

The stamps of all sources go back to where they began, and what is stamped so has been there before, bytes equal; only
the times of recording go on. A clock that was set back shows other sweeps, and seldom the same nanoseconds.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import I64
from dynmap_cli.ingest.choices.clock_offsets import delay_of
from dynmap_cli.ingest.raw.columns import spans
from dynmap_cli.ingest.raw.laser import RawLaser, most_used
from dynmap_cli.ingest.raw.recording import RawRecording, file_name
from dynmap_cli.ingest.raw.stamped import Stamped

_BACK_NS = -(10**8)
_LEAST_SCANS, _MOST_COMPARED = 10, 256


def drop_repeats(recording: RawRecording) -> None:
    """Keep the first of all messages that a source has with one stamp in several passes, in order of time; says so.

    So of a pass that was recorded in part all is there that any pass has. Times of recording are put on those of the
    first pass.
    """
    laser = most_used(recording.lasers.values())
    if laser is None:
        return
    cuts = _returns_of(laser.stamps_ns)
    if not cuts.size:
        return
    first, of_row = _firsts_of(laser.stamps_ns, cuts)
    again = np.flatnonzero(first[of_row] != np.arange(of_row.size))
    if again.size < _LEAST_SCANS * cuts.size or not _are_equal(laser, first[of_row[again]], again):
        return
    moving = [one for one in recording.transforms.values() if not one.is_static]
    for source in [*recording.lasers.values(), *recording.odometry.values(), *moving]:
        _keep_first(source)
    recording.dropped["scan that repeats stamp and ranges of another"] += again.size
    recording.warnings.append(
        f"{file_name(recording.name)}: a recording that was played {cuts.size + 1} times (as by `ros2 bag play "
        f"--loop`): {laser.name} goes back to stamps it had, with the same ranges; each scan is used once"
    )


def _returns_of(stamps_ns: I64) -> I64:
    """Numbers (n,) of the stamps that lie well before the one before."""
    found = [np.zeros(0, dtype=np.int64)]
    for rows in spans(max(stamps_ns.size - 1, 0), stamps_ns):
        steps_ns = np.diff(stamps_ns[rows.start : rows.stop + 1])
        found.append(rows.start + 1 + np.flatnonzero(steps_ns < _BACK_NS))
    return np.concatenate(found)


def _firsts_of(stamps_ns: I64, cuts: I64) -> tuple[I64, I64]:
    """Where each stamp comes first (k,), in order of time, and which of these each row (n,) has.

    What has one stamp in one pass, as messages that a driver sends twice or the layers of a laser, repeats nothing: the
    first of them is that with the first of another pass, the second that with the second.
    """
    _, of_stamp = np.unique(stamps_ns, return_inverse=True)
    of_pass = np.searchsorted(cuts, np.arange(stamps_ns.size), side="right")
    order = np.lexsort((of_pass, of_stamp))
    is_new = (np.diff(of_stamp[order], prepend=-1) != 0) | (np.diff(of_pass[order], prepend=-1) != 0)
    place = np.arange(order.size)
    rank = np.empty_like(place)
    rank[order] = place - np.maximum.accumulate(np.where(is_new, place, 0))
    _, first, of_row = np.unique(of_stamp * (rank.max() + 1) + rank, return_index=True, return_inverse=True)
    return first, of_row


def _are_equal(laser: RawLaser, before: I64, again: I64) -> bool:
    """Whether sweeps have the ranges of others of their stamp; some hundreds, evenly spread, tell."""
    looks = np.unique(np.linspace(0, again.size - 1, min(_MOST_COMPARED, again.size)).astype(np.int64))
    return all(
        laser.shape_index[one] == laser.shape_index[other]
        and np.array_equal(laser.ranges_of(one), laser.ranges_of(other), equal_nan=True)
        for one, other in zip(before[looks].tolist(), again[looks].tolist(), strict=True)
    )


def _keep_first(source: Stamped) -> None:
    """Forget what has a stamp of another pass again, and let no pass be recorded later than the first."""
    cuts = _returns_of(source.stamps_ns)
    if not cuts.size:
        return
    stamps_ns, logged_ns = source.stamps_ns, source.logged_ns.copy()
    edges = [0, *cuts.tolist(), stamps_ns.size]
    delays_ns = [delay_of(stamps_ns[low:high], logged_ns[low:high])[0] for low, high in pairwise(edges)]
    for low, high, delay_ns in zip(edges[1:-1], edges[2:], delays_ns[1:], strict=True):
        logged_ns[low:high] -= delay_ns - delays_ns[0]
    source.logged_ns = logged_ns
    source.keep(_firsts_of(stamps_ns, cuts)[0])
