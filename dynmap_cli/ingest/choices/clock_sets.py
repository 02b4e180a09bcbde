"""Recordings while which the clock was set: what is stamped before and after is put on one clock.

Nobody knows how long it really took; in the order of recording the next sweep comes one period later. Odometry and
transforms whose stamps jump by as much at their place in that order are moved alike. Where messages only stand in the
wrong order, as rows of a damaged database may, they fit together in order of time, and nothing is moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import I64
from dynmap_cli.ingest.choices.merging import period_s_of
from dynmap_cli.ingest.raw.columns import ascends, steps_in
from dynmap_cli.ingest.raw.laser import LONGEST_REACH_M, RawLaser, most_used
from dynmap_cli.ingest.raw.recording import RawRecording, StampedRows, file_name

_BACK_NS, _FORTH_NS = -5 * 10**9, 7 * 86_400 * 10**9
_ALIKE_NS = 5 * 10**9
_LEAST_SCANS, _MOST_JUMPS = 10, 4
LEAST_BACK_NS = -(10**8)
_TWICE_AS_OFTEN, _USUAL_QUANTILE, _LEAST_MIXED = 0.7, 0.9, 3
_LONGEST_SEAM_NS = 5 * 10**9


class _Sets(NamedTuple):
    """Where the clock was set, by the sweeps of one laser.

    Attributes
    ----------
    cuts : list of int
        Numbers of the sweeps before which it was set.
    jumps_ns : list of int
        From the sweep before to that one.
    shifts_ns : (n_cuts + 1,) int64
        What is to be added to the times of each part.
    """

    cuts: list[int]
    jumps_ns: list[int]
    shifts_ns: I64

    @property
    def told(self) -> str:
        """By how much it was set each time."""
        return ", ".join(f"{jump_ns * 1e-9:+.3f} s" for jump_ns in self.jumps_ns)

    def moved(self, times_ns: I64, cuts: Sequence[int]) -> I64:
        """Times (n,) of a source, that jump before the given numbers, on one clock."""
        parts = zip(np.split(times_ns, cuts), self.shifts_ns, strict=True)
        return np.concatenate([part + shift_ns for part, shift_ns in parts])

    def without_overlap(self, sources: Sequence[tuple[I64, Sequence[int]]]) -> _Sets:
        """The same with so much more time at each cut that no source, times (n,) and cuts, goes back there.

        Others may go on before the laser does, as odometry where a simulation is started anew.
        """
        more_ns = np.zeros(len(self.cuts) + 1, dtype=np.int64)
        for times_ns, cuts in sources:
            for number, cut in enumerate(cuts):
                gap_ns = int(
                    times_ns[cut] + self.shifts_ns[number + 1] - times_ns[cut - 1] - self.shifts_ns[number]
                )
                if gap_ns <= 0:
                    usual_ns = round(period_s_of(times_ns[max(cut - _LEAST_SCANS, 0) : cut]) * 1e9)
                    more_ns[number + 1] = max(more_ns[number + 1], usual_ns - gap_ns)
        later_ns = self.shifts_ns + np.cumsum(more_ns)
        return self._replace(shifts_ns=later_ns - later_ns[np.argmin(np.abs(self.shifts_ns))])


def join_set_clocks(recording: RawRecording) -> None:
    """Move stamps from before and after the clock was set to the clock of most sweeps, and say so."""
    laser = most_used(recording.lasers.values())
    if laser is None:
        return
    found = _sets_of(laser.stamps_ns, _jumps_of(laser.stamps_ns))
    if found is None:
        return
    if _stand_out_of_order(laser, np.array(found.cuts)):
        for source in _moving(recording):
            if not ascends(source.stamps_ns):
                source.keep(np.argsort(source.stamps_ns, kind="stable"))
        recording.warnings.append(
            f"{file_name(recording.name)}: its messages do not stand in the order of time: {laser.name} jumps by "
            f"{found.told}, and so do the times of recording; they are put in order by their stamps"
        )
        return
    cut = [
        (source, found.cuts if source is laser else _cuts_of(source.stamps_ns, found.jumps_ns))
        for source in _moving(recording)
    ]
    moving = [(source, cuts) for source, cuts in cut if cuts is not None]
    found = found.without_overlap([(source.stamps_ns, cuts) for source, cuts in moving])
    for source, cuts in moving:
        source.stamps_ns = found.moved(source.stamps_ns, cuts)
    _say(recording, laser, found)


def interleaved_ns(recording: RawRecording) -> tuple[int, int] | None:
    """From when to when sweeps come twice as often, as where messages are sorted by a clock that was set back.

    Two periods lie between a sweep and the next but one, there only one; None where that is so nowhere for long. What
    the periods are is told by sweeps of different stamps: simulations stamp alike each time.
    """
    laser = most_used(recording.lasers.values())
    if laser is None or laser.n_scans < 2 * _LEAST_SCANS:
        return None
    ordered = laser.stamps_ns if ascends(laser.stamps_ns) else np.sort(laser.stamps_ns)
    apart_ns = ordered[2:] - ordered[:-2]
    distinct = np.concatenate([[True], ordered[1:] > ordered[:-1]])
    usual_ns = apart_ns if distinct.all() else np.subtract(ordered[distinct][2:], ordered[distinct][:-2])
    if not usual_ns.size:
        return None
    usual = int(_USUAL_QUANTILE * usual_ns.size)
    is_short = apart_ns < _TWICE_AS_OFTEN * float(np.partition(usual_ns, usual)[usual])
    if np.count_nonzero(is_short) < _LEAST_MIXED:
        return None
    n_short = np.concatenate([[0], np.cumsum(is_short)])
    runs = np.flatnonzero(n_short[_LEAST_MIXED:] - n_short[:-_LEAST_MIXED] == _LEAST_MIXED)
    return (int(ordered[runs[0]]), int(ordered[runs[-1] + _LEAST_MIXED + 1])) if runs.size else None


def undo_set_back(recording: RawRecording) -> bool:
    """Put times of recording that go back in messages as they were written onto one clock, with the stamps that do so.

    Returns
    -------
    bool
        Whether there were such, which is said.
    """
    laser = most_used(recording.lasers.values())
    if laser is None:
        return False
    steps_ns = np.concatenate([np.zeros(1, dtype=np.int64), *steps_in(laser.logged_ns)])
    found = _sets_of(laser.logged_ns, np.flatnonzero(steps_ns < LEAST_BACK_NS))
    if found is None:
        return False
    cut = [(source, _cuts_of(source.logged_ns, found.jumps_ns)) for source in _moving(recording)]
    moving = [(source, cuts) for source, cuts in cut if cuts is not None]
    found = found.without_overlap([(source.logged_ns, cuts) for source, cuts in moving])
    for source, cuts in moving:
        steps_ns = np.diff(source.stamps_ns)[np.array(cuts) - 1]
        if all(abs(a - b) < _alike_ns(b) for a, b in zip(steps_ns.tolist(), found.jumps_ns, strict=True)):
            source.stamps_ns = found.moved(source.stamps_ns, cuts)
        source.logged_ns = found.moved(source.logged_ns, cuts)
    _say(recording, laser, found)
    return True


def _moving(recording: RawRecording) -> list[RawLaser | StampedRows]:
    """All that has times that matter."""
    moving = [one for one in recording.transforms.values() if not one.is_static]
    return [*recording.lasers.values(), *recording.odometry.values(), *moving]


def _sets_of(times_ns: I64, cuts: I64) -> _Sets | None:
    """What is to be done where the times (n,) of the sweeps jump; None where they do not, or too often."""
    sizes = np.diff([0, *cuts.tolist(), times_ns.size])
    if not 0 < cuts.size <= _MOST_JUMPS or sizes.min() < _LEAST_SCANS:
        return None
    jumps_ns = (times_ns[cuts] - times_ns[cuts - 1]).tolist()
    period_ns = round(period_s_of(np.concatenate([np.sort(part) for part in np.split(times_ns, cuts)])) * 1e9)
    shifts_ns = np.concatenate([[0], np.cumsum([period_ns - jump_ns for jump_ns in jumps_ns])]).astype(
        np.int64
    )
    shifts_ns -= shifts_ns[max(range(sizes.size), key=lambda part: (sizes[part], part))]
    return _Sets(cuts.tolist(), jumps_ns, shifts_ns)


def _stand_out_of_order(laser: RawLaser, cuts: I64) -> bool:
    """Whether the sweeps go on in order of time, without overlap or a long pause, at least as they do as written.

    What a clock stamps that was set back lies over what it stamped before, or anywhere, but not right in front of it.
    """
    stamps_ns, logged_ns = laser.stamps_ns, laser.logged_ns
    jumps_ns = stamps_ns[cuts] - stamps_ns[cuts - 1]
    apart_ns = logged_ns[cuts] - logged_ns[cuts - 1] - jumps_ns
    if (np.abs(apart_ns) > _ALIKE_NS).any() or not (jumps_ns < 0).all():
        return False
    order = np.argsort(stamps_ns, kind="stable")
    part = np.searchsorted(cuts, order, side="right")
    seams = np.flatnonzero(np.diff(part)) + 1
    before, after = order[seams - 1], order[seams]
    if seams.size > 2 * cuts.size or (stamps_ns[after] - stamps_ns[before] > _LONGEST_SEAM_NS).any():
        return False
    return _change_m(laser, before, after) <= _change_m(laser, cuts - 1, cuts)


def _change_m(laser: RawLaser, before: I64, after: I64) -> float:
    """Median change of the ranges of sweeps to those of others, metres, each (n,) numbers."""
    ranges_m = np.zeros((2, before.size, int(laser.lengths_counted[0][-1])), dtype=np.float32)
    for table, numbers in zip(ranges_m, (before, after), strict=True):
        laser.fill(table, numbers)
    ranges_m[~(np.abs(ranges_m) < LONGEST_REACH_M)] = LONGEST_REACH_M
    return float(np.median(np.abs(ranges_m[1] - ranges_m[0])))


def _say(recording: RawRecording, laser: RawLaser, found: _Sets) -> None:
    """Say by how much the clock was set."""
    recording.warnings.append(
        f"{file_name(recording.name)}: the clock was set while it was made: {laser.name} jumps by {found.told}; its "
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
        found = np.flatnonzero(np.abs(steps_ns[start:] - jump_ns) < _alike_ns(jump_ns))
        if not found.size:
            return None
        cuts.append(start + int(found[0]) + 1)
        start = cuts[-1]
    return cuts


def _alike_ns(jump_ns: int) -> float:
    """By how much another source may jump more or less: it has a period of its own."""
    return min(_ALIKE_NS, abs(jump_ns) / 2)
