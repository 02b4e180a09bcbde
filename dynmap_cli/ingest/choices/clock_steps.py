"""Clocks that were set while a recording was made, told by the times of recording: these go on where stamps jump.

From one message to the next the stamps of a source step by more or less than the times of recording, which go on as
before, and the delay from stamp to recording stays at its new level. Where the delay grows, no slow program does that,
for its stamps go on. Where it shrinks, a slow program may have dropped what waited: then the turns of the
sweeps tell, or the way of the odometry where all that is recorded steps at once, as where the recorder was late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dynmap_cli.arrays import I64
from dynmap_cli.ingest.choices.clock_evidence import (
    Fit,
    best_fit,
    fit_of_laser,
    fit_of_track,
    share_of_pace,
)
from dynmap_cli.ingest.choices.clock_offsets import Source, delay_of, stamped_sources
from dynmap_cli.ingest.raw.columns import spans
from dynmap_cli.ingest.raw.laser import RawLaser, most_used
from dynmap_cli.ingest.raw.recording import RawRecording, file_name

_LEAST_STEP_S, _MOST_OFF = 0.2, 0.25
_LEAST_MESSAGES, _LOOKED_AT, _MOST_STEPS, _MOST_LOOKS = 10, 20, 4, 200
_AT_ONCE_S, _LONGEST_QUEUE_S = 2.0, 60.0
_SURELY_SET, _SURELY_LATE = 0.4, 0.6


class _Parts(NamedTuple):
    """Messages of one source between the steps of its clock.

    Attributes
    ----------
    delays_ns : (n_parts,) int64
        Median time from stamp to recording in each part.
    sizes : (n_parts,) int64
    """

    delays_ns: I64
    sizes: I64

    def nearest_ns(self, delay_ns: int) -> int:
        """The delay of a part that is nearest to another."""
        return int(self.delays_ns[np.argmin(np.abs(self.delays_ns - delay_ns))])

    @property
    def longest_ns(self) -> int:
        """The delay of the part with most messages, of equal ones the last."""
        return int(self.delays_ns[self.sizes.size - 1 - np.argmax(self.sizes[::-1])])


@dataclass(slots=True)
class _Steps:
    """A source whose clock may have been set.

    Attributes
    ----------
    name : str
    source : Source
    parts : _Parts
    shifts_ns : (n_parts,) int64
        What is to be added to the stamps of each part.
    """

    name: str
    source: Source
    parts: _Parts
    shifts_ns: I64

    @property
    def edges(self) -> I64:
        """Numbers (n_parts + 1,) of the messages at which parts begin and end."""
        return np.concatenate([[0], np.cumsum(self.parts.sizes)])

    @property
    def steps_ns(self) -> I64:
        """By how much (n_parts - 1,) the stamps jump against the times of recording."""
        return -np.diff(self.parts.delays_ns)

    def is_with(self, other: _Steps) -> bool:
        """Whether another source steps by as much at the same times."""
        if self.parts.sizes.size != other.parts.sizes.size:
            return False
        at_ns = [one.source.logged_ns[one.edges[1:-1]] for one in (self, other)]
        is_alike = np.abs(self.steps_ns - other.steps_ns) < _MOST_OFF * np.abs(self.steps_ns)
        return bool((is_alike & (np.abs(at_ns[0] - at_ns[1]) < _AT_ONCE_S * 1e9)).all())

    def fit(self, number: int, steady: Sequence[Source]) -> Fit:
        """How one part fits those that do not step."""
        part, shift_ns = slice(*self.edges[number : number + 2].tolist()), int(self.shifts_ns[number])
        lasers = [one for one in steady if isinstance(one, RawLaser)]
        if isinstance(self.source, RawLaser):
            tracks = [one for one in steady if not isinstance(one, RawLaser)]
            return fit_of_laser(self.source, part, shift_ns, tracks)
        laser = most_used(lasers)
        return best_fit([] if laser is None else [fit_of_track(self.source, part, shift_ns, laser)])


def mend_clock_steps(recording: RawRecording) -> None:
    """Put each source whose clock was set onto one clock, that of the other sources or of most scans; says so."""
    if not recording.lasers:
        return
    sources = dict(stamped_sources(recording))
    cuts = {name: _cuts_of(source.stamps_ns, source.logged_ns) for name, source in sources.items()}
    if not any(found.size for found in cuts.values()):
        return
    steps = _steps_of(recording, sources, cuts)
    steady = [
        source
        for name, source in sources.items()
        if not cuts[name].size and source.stamps_ns.size >= 2 * _LEAST_MESSAGES
    ]
    groups = _groups(steps)
    if not steady and len(groups) == 1:
        doubtful = _doubtful_together(groups[0])
    else:
        doubtful = [one for group in groups for one in _doubtful(group, steady)] if steady else []
    moved = [one for one in steps if one.shifts_ns.any()]
    for one in moved:
        one.source.stamps_ns = one.source.stamps_ns + np.repeat(one.shifts_ns, one.parts.sizes)
    name = file_name(recording.name)
    if moved:
        recording.warnings.append(
            f"{name}: the clock was set while it was made: {_told(moved)} against the times of recording; by these "
            "the stamps are put on one clock"
        )
    if doubtful:
        recording.warnings.append(
            f"{name}: {_told(doubtful)} against the times of recording; whether the clock was set or messages that "
            "waited were lost is not told by how the robot moved: these stamps stay as they are"
        )


def _steps_of(recording: RawRecording, sources: dict[str, Source], cuts: dict[str, I64]) -> list[_Steps]:
    """Sources that step, with what puts each on one clock."""
    parts = {name: _parts_of(source, cuts[name]) for name, source in sources.items()}
    steady_ns = [found.longest_ns for found in parts.values() if found is not None and found.sizes.size == 1]
    laser = most_used(recording.lasers.values())
    own = None if laser is None else parts[laser.name]
    clock_ns = own.longest_ns if own is not None else None
    if own is not None and own.sizes.size > 1 and steady_ns:
        clock_ns = own.nearest_ns(int(np.median(steady_ns)))
    steps = []
    for name, source in sources.items():
        found = parts[name]
        if found is not None and found.sizes.size > 1:
            target_ns = found.longest_ns if clock_ns is None else found.nearest_ns(clock_ns)
            steps.append(_Steps(name, source, found, found.delays_ns - target_ns))
    return steps


def _groups(steps: Sequence[_Steps]) -> list[list[_Steps]]:
    """Sources that step together, as those do that are stamped by one clock or written by one program."""
    groups: list[list[_Steps]] = []
    for one in steps:
        group = next((known for known in groups if known[0].is_with(one)), None)
        if group is None:
            groups.append([one])
        else:
            group.append(one)
    return groups


def _doubtful(group: Sequence[_Steps], steady: Sequence[Source]) -> list[_Steps]:
    """Leave parts as stamped whose clock was not set; returns those of which that is not told."""
    if any((one.steps_ns < 0).any() for one in group):
        return []
    doubtful = []
    for number in range(group[0].parts.sizes.size):
        moving = [one for one in group if one.shifts_ns[number]]
        fit = best_fit([one.fit(number, steady) for one in moving])
        # No program stamps ahead because it is slow, and none is so slow.
        is_clock = any(not 0 < one.shifts_ns[number] < _LONGEST_QUEUE_S * 1e9 for one in moving)
        if fit.is_set or (is_clock and not fit.is_late):
            continue
        doubtful += [] if fit.is_late else moving
        for one in moving:
            one.shifts_ns[number] = 0
    return [one for one in group if any(one is other for other in doubtful)]


def _doubtful_together(group: Sequence[_Steps]) -> list[_Steps]:
    """Leave all as stamped where a late recorder lost what waited; returns those of which that is not told."""
    steps_ns = np.concatenate([one.steps_ns for one in group])
    if not ((steps_ns > 0) & (steps_ns < _LONGEST_QUEUE_S * 1e9)).all():
        return []
    shares = [
        share_of_pace(one.source, cut)
        for one in group
        if not isinstance(one.source, RawLaser)
        for cut in one.edges[1:-1].tolist()
    ]
    known = [share for share in shares if np.isfinite(share)]
    if known and max(known) < _SURELY_SET:
        return []
    for one in group:
        one.shifts_ns[:] = 0
    return [] if known and max(known) > _SURELY_LATE else [*group]


def _told(steps: Sequence[_Steps]) -> str:
    """By how much sources jump."""
    return "; ".join(
        f"{one.name} jumps by {', '.join(f'{step_ns * 1e-9:+.3f} s' for step_ns in one.steps_ns)}"
        for one in steps
    )


def _parts_of(source: Source, cuts: I64) -> _Parts | None:
    """Part messages where their clock was set; None where the delay within a part varies, or there are too few."""
    edges = [0, *cuts.tolist(), source.stamps_ns.size]
    sizes = np.diff(edges)
    if cuts.size > _MOST_STEPS or sizes.min() < _LEAST_MESSAGES:
        return None
    delays = [
        delay_of(source.stamps_ns[first:last], source.logged_ns[first:last])
        for first, last in pairwise(edges)
    ]
    delays_ns = np.array([delay_ns for delay_ns, _ in delays])
    steps_s = np.abs(np.diff(delays_ns)) * 1e-9
    is_steady = max(spread_s for _, spread_s in delays) < _MOST_OFF * steps_s.min(initial=np.inf)
    return _Parts(delays_ns, sizes) if is_steady else None


def _cuts_of(stamps_ns: I64, logged_ns: I64) -> I64:
    """Numbers (n_steps,) of the messages at which stamps step, times of recording do not, and the delay stays."""
    found = [np.zeros(0, dtype=np.int64)]
    for rows in spans(max(stamps_ns.size - 1, 0), stamps_ns, logged_ns):
        both = slice(rows.start, rows.stop + 1)
        steps_ns = np.diff(logged_ns[both] - stamps_ns[both])
        found.append(rows.start + 1 + np.flatnonzero(np.abs(steps_ns) >= _LEAST_STEP_S * 1e9))
    looks = np.concatenate(found)
    if looks.size > _MOST_LOOKS:
        return looks[:0]
    return np.array([one for one in looks.tolist() if _is_set(stamps_ns, logged_ns, one)], dtype=np.int64)


def _is_set(stamps_ns: I64, logged_ns: I64, number: int) -> bool:
    """Whether the clock was set right before one message, by the times of recording and the delays around it."""
    around = slice(max(number - _LOOKED_AT, 0), number + _LOOKED_AT)
    before, after = slice(around.start, number), slice(number, around.stop)
    if min(stamps_ns[before].size, stamps_ns[after].size) < _LEAST_MESSAGES:
        return False
    stamp_s, logged_s = (int(times[number] - times[number - 1]) * 1e-9 for times in (stamps_ns, logged_ns))
    step_s = stamp_s - logged_s
    most_off_s = _MOST_OFF * abs(step_s)
    if abs(logged_s - float(np.median(np.diff(logged_ns[around]))) * 1e-9) >= most_off_s:
        return False
    delays_ns = [delay_of(stamps_ns[part], logged_ns[part])[0] for part in (before, after)]
    return abs((delays_ns[0] - delays_ns[1]) * 1e-9 - step_s) < most_off_s
