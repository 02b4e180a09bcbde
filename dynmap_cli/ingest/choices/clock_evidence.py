"""Whether a clock was set or a slow program dropped what waited: stamps and times of recording step alike in both.

A program that is late by so much stamps right; when its queue is emptied, so many messages are lost and the next is
recorded in time. A clock that is set forward looks the same, but loses nothing. Which it was is told by the turns of
the sweeps, held against odometry that does not step: where its stamps are right, and where they are moved. Where all
sources step together, a track that is driven on tells: it moves over the step as far as in the time that passed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.ingest.choices.clock_offsets import agreement_moved, off_rad
from dynmap_cli.ingest.choices.tracks import Track, part_of, poses_of, yaws_at
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.seen_motion.turns import Headings, ScanTurns, turns_of

_CLEARLY = 0.7
_MOST_TRACKS = 4
_LOOKED_AROUND, _SHORTEST_S, _STANDS = 10, 1e-3, 1e-3


class Fit(NamedTuple):
    """What is left of the turns of the sweeps beside those of the odometry, radians; inf where nothing turns.

    Attributes
    ----------
    stamped_rad, moved_rad : float
        With the stamps as they are, and moved by the times of recording.
    """

    stamped_rad: float
    moved_rad: float

    @property
    def is_set(self) -> bool:
        """Whether the clock clearly was set."""
        return self.moved_rad < _CLEARLY * self.stamped_rad

    @property
    def is_late(self) -> bool:
        """Whether the stamps clearly are right."""
        return self.stamped_rad < _CLEARLY * self.moved_rad


def best_fit(fits: Iterable[Fit]) -> Fit:
    """That of several in which least is left, either way."""
    return min(fits, key=min, default=Fit(np.inf, np.inf))


def fit_of_laser(laser: RawLaser, part: slice, shift_ns: int, tracks: Sequence[Track]) -> Fit:
    """Hold the turns of some sweeps of a laser, as stamped and moved, against tracks that do not step."""
    tracks = tracks[:_MOST_TRACKS]
    turns = _turns(laser, part, tracks, -shift_ns)
    return best_fit(_fit(track, turns, -shift_ns) for track in tracks)


def fit_of_track(track: Track, part: slice, shift_ns: int, laser: RawLaser) -> Fit:
    """Hold some poses of a track, as stamped and moved, against the turns of a laser that does not step."""
    poses = part_of(track, part)
    return _fit(poses, _turns(laser, slice(0, laser.n_scans), [poses], shift_ns), shift_ns)


def share_of_pace(track: Track, number: int) -> float:
    """How far a track moves to one pose: 0 = as between those around it, 1 = as in the time since the stamp before.

    That of its way and its turn which is greater: who drives there and back is not where the pace would lead. NaN where
    it stands.
    """
    around = slice(max(number - _LOOKED_AROUND, 0), number + _LOOKED_AROUND)
    own = number - 1 - around.start
    steps = np.diff(poses_of(part_of(track, around)), axis=0)
    moved = np.column_stack([np.hypot(steps[:, 0], steps[:, 1]), np.abs(wrap_angle(steps[:, 2]))])
    usual = np.delete(moved, own, axis=0).mean(axis=0)
    steps_s = np.diff(track.stamps_ns[around]) * 1e-9
    missed_s = float(steps_s[own]) - float(np.median(np.delete(steps_s, own)))
    pace = usual / max(float(np.delete(steps_s, own).mean()), _SHORTEST_S)
    is_moving = usual > _STANDS
    return float(((moved[own] - usual) / (pace * missed_s))[is_moving].max()) if is_moving.any() else np.nan


def _fit(track: Track, turns: ScanTurns, shift_ns: int) -> Fit:
    """How the turns of sweeps agree with a track as stamped, and with one that is moved."""
    return Fit(*(off_rad(agreement_moved(track, turns, moved_ns)) for moved_ns in (0, shift_ns)))


def _turns(laser: RawLaser, part: slice, tracks: Sequence[Track], shift_ns: int) -> ScanTurns:
    """Turns of some sweeps, many of them where tracks turn, as stamped or moved."""
    stamps_ns = np.sort(laser.stamps_ns[part])
    headings = []
    for track in tracks:
        for moved_ns in (0, shift_ns):
            poses = np.zeros((stamps_ns.size, 3))
            poses[:, 2] = yaws_at(track, stamps_ns - moved_ns)
            headings.append(poses)
    return turns_of(laser, Headings(stamps_ns, headings), part)
