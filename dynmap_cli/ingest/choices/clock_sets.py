"""Recordings while which the clock was set: what is stamped before and after is put on one clock.

Nobody knows how long it really took; in the order of recording the next sweep comes one period later. Odometry and
transforms whose stamps jump by as much at their place in that order are moved alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynmap_cli.arrays import I64
from dynmap_cli.ingest.choices.merging import period_s_of
from dynmap_cli.ingest.raw.columns import steps_in
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.recording import RawRecording, StampedRows, file_name

_BACK_NS, _FORTH_NS = -5 * 10**9, 7 * 86_400 * 10**9
_ALIKE_NS = 5 * 10**9
_LEAST_SCANS, _MOST_JUMPS = 10, 4


def join_set_clocks(recording: RawRecording) -> None:
    """Move stamps from before and after the clock was set to the clock of most sweeps, and say so."""
    if not recording.lasers:
        return
    laser = max(recording.lasers.values(), key=lambda one: (one.n_scans, one.name))
    stamps_ns = laser.stamps_ns
    cuts = _jumps_of(stamps_ns)
    sizes = np.diff([0, *cuts.tolist(), stamps_ns.size])
    if not 0 < cuts.size <= _MOST_JUMPS or sizes.min() < _LEAST_SCANS:
        return
    jumps_ns = (stamps_ns[cuts] - stamps_ns[cuts - 1]).tolist()
    period_ns = round(
        period_s_of(np.concatenate([np.sort(part) for part in np.split(stamps_ns, cuts)])) * 1e9
    )
    shifts_ns = np.concatenate([[0], np.cumsum([period_ns - jump_ns for jump_ns in jumps_ns])]).astype(
        np.int64
    )
    shifts_ns -= shifts_ns[max(range(sizes.size), key=lambda part: (sizes[part], part))]
    others: list[RawLaser | StampedRows] = [*recording.lasers.values(), *recording.odometry.values()]
    others += [one for one in recording.transforms.values() if not one.is_static]
    for source in others:
        own = cuts.tolist() if source is laser else _cuts_of(source.stamps_ns, jumps_ns)
        if own is not None:
            parts = np.split(source.stamps_ns, own)
            moved = [part + shift_ns for part, shift_ns in zip(parts, shifts_ns, strict=True)]
            source.stamps_ns = np.concatenate(moved)
    told = ", ".join(f"{jump_ns * 1e-9:+.3f} s" for jump_ns in jumps_ns)
    recording.warnings.append(
        f"{file_name(recording.name)}: the clock was set while it was made: {laser.name} jumps by {told}; its "
        "stamps are moved to the clock of most scans, as if no time had passed there"
    )


def _jumps_of(stamps_ns: I64) -> I64:
    """Numbers (n_jumps,) of the stamps (n,) before which the clock jumped; block by block, to save memory."""
    found, start = [], 1
    for steps_ns in steps_in(stamps_ns):
        found.append(start + np.flatnonzero((steps_ns < _BACK_NS) | (steps_ns > _FORTH_NS)))
        start += steps_ns.size
    return np.concatenate(found) if found else np.zeros(0, dtype=np.int64)


def _cuts_of(stamps_ns: I64, jumps_ns: Sequence[int]) -> list[int] | None:
    """Where in the order of recording stamps (n,) jump alike, one jump after the other; None where they do not."""
    steps_ns = np.diff(stamps_ns)
    cuts, start = [], 0
    for jump_ns in jumps_ns:
        found = np.flatnonzero(np.abs(steps_ns[start:] - jump_ns) < _ALIKE_NS)
        if not found.size:
            return None
        cuts.append(start + int(found[0]) + 1)
        start = cuts[-1]
    return cuts
