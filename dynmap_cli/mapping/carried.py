"""Where a robot was carried inside a drive: what it sees before and after contradicts its odometry."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.poses import between, compose, inverse
from dynmap_cli.kernels.beams import Rays
from dynmap_cli.kernels.map_fits import MATCHED, SEEN
from dynmap_cli.mapping.local_maps import Collector, Easel, LocalMap
from dynmap_cli.scan_matching.front_end import Registered
from dynmap_cli.scan_matching.sweeps import Sweeps

_USUAL_SCANS, _WORSE_SHARE = 8, 0.1
_JUMP_M, _JUMP_RAD = 0.3, 0.3
_TOGETHER_S = 2.0
_KEYS, _SCANS_AFTER = 8, 60
_ROLLED_M = 1.0
"""Wheels of a robot in somebody's hands hardly turn; where they do, it saw other things since."""
_NEAR_M, _NEAR_RAD = 0.3, 0.2
_AGREE_SHARE, _SURELY_AGREE_SHARE = 0.6, 0.85
"""Share of matching points under which two local maps contradict each other; above the other no search is needed.
Where nothing was carried it is 0.8 and more nearly always, in a crowd or with scans a metre apart at least 0.64."""
_LEAST_POINTS, _IN_FREE_SHARE = 100, 0.12
_SCAN_SEEN, _SCAN_MATCHED = 0.3, 0.7

Match = Callable[[int, int], Registered]
"""Registers the scans first..last - 1 on their own."""


@dataclass(frozen=True, slots=True)
class Carry:
    """A time in which the robot was in somebody's hands, or moved while nothing was recorded.

    Attributes
    ----------
    last_before, first_after : int
        Scans between which it happened; those in between fit neither.
    """

    last_before: int
    first_after: int


def find_carries(sweeps: Sweeps, rays: Rays, front: Registered, motion: F64, match: Match) -> list[Carry]:
    """Find where a drive falls into parts that its odometry does not join.

    Suspicious is where scans fit the ones before clearly worse than usual, or only after a jump. There the local map
    of the scans before is laid on that of the scans after by the odometry. The robot was carried where they agree
    neither near that pose nor near the one to which the front end led without a jump.

    Parameters
    ----------
    sweeps : Sweeps
        Of one drive.
    rays : Rays
    front : Registered
        What the front end made of it.
    motion : (n_scans, 3) float64
        Corrected odometry steps, NaN where there are none.
    match : callable
        Used for scans after a suspicious place, which it is to register without those before.
    """
    is_jump = _jumps(front.poses, motion)
    bad = np.flatnonzero(
        front.is_lost | is_jump | _fits_worse(front.shares, rays.laser_index[sweeps.geometry_index])
    )
    if bad.size == 0:
        return []
    judge = _Judge(sweeps, rays, front, motion, is_jump, match)
    stretches = np.split(bad, np.flatnonzero(np.diff(sweeps.times_s[bad]) > _TOGETHER_S) + 1)
    found = [judge.carry(*ends) for stretch in stretches for ends in judge.in_one_place(stretch)]
    return [carry for carry in found if carry is not None]


def _jumps(poses: F64, motion: F64) -> B1:
    """(n,) steps of the path that are neither what the odometry counts nor like the step before or after."""
    steps = np.zeros_like(poses)
    steps[1:] = between(poses[:-1], poses[1:])
    is_jump = np.isfinite(motion).all(axis=1)
    for other in (motion, np.roll(steps, 1, axis=0), np.roll(steps, -1, axis=0)):
        error = between(other, steps)
        is_jump &= (np.hypot(error[:, 0], error[:, 1]) > _JUMP_M) | (np.abs(error[:, 2]) > _JUMP_RAD)
    return np.asarray(is_jump)


def _fits_worse(shares: F64, laser: I64) -> B1:
    """(n,) scans that fit worse than the ones before of the same laser."""
    is_worse = np.zeros(shares.size, dtype=bool)
    for one in np.unique(laser):
        rows = np.flatnonzero(laser == one)
        own = shares[rows]
        for number in np.flatnonzero(own < np.median(own)).tolist():
            usual = own[max(number - _USUAL_SCANS, 0) : number]
            is_worse[rows[number]] = usual.size > 0 and np.median(usual) - own[number] > _WORSE_SHARE
    return is_worse


class _Judge:
    """Tells whether a robot was carried in a stretch in which its scans fit badly."""

    def __init__(
        self, sweeps: Sweeps, rays: Rays, front: Registered, motion: F64, is_jump: B1, match: Match
    ) -> None:
        self._sweeps, self._rays, self._front, self._motion, self._match = sweeps, rays, front, motion, match
        self._is_jump, self._keys = is_jump, np.flatnonzero(front.is_key)
        self._collector = Collector(sweeps, rays)
        self._before, self._after = Easel(), Easel()

    def in_one_place(self, bad: I64) -> list[tuple[int, int]]:
        """First and last of scans that fit badly, parted at their longest breaks until the wheels hardly turn."""
        first, last = int(bad[0]), int(bad[-1])
        way = self._rolled(max(first - 1, 0), min(last + 1, self._sweeps.n_scans - 1))
        if bad.size < 2 or not np.hypot(way[0], way[1]) > _ROLLED_M / 2:
            return [(first, last)]
        cut = int(np.argmax(np.diff(self._sweeps.times_s[bad]))) + 1
        return [*self.in_one_place(bad[:cut]), *self.in_one_place(bad[cut:])]

    def carry(self, first: int, last: int) -> Carry | None:
        """Where the robot was carried about these scans, which fit badly; None where it was not."""
        before, after = first - 1, last + 1
        if before < 0 or after >= self._sweeps.n_scans:
            return None
        rolled = self._rolled(before, after)
        if not np.hypot(rolled[0], rolled[1]) <= _ROLLED_M:
            return None
        guesses = [rolled]
        if not self._is_jump[before + 1 : after + 1].any():
            guesses.append(between(self._front.poses[before], self._front.poses[after]))
        old = self._map(self._keys[self._keys <= before][-_KEYS:], before, self._front, 0)
        later = self._keys[self._keys >= after][:_KEYS]
        if later.size and self._agree_at(old, self._map(later, after, self._front, 0), guesses):
            return None
        # Without the scans before, which may have pulled them to somewhere else.
        found = self._match(after, min(after + _SCANS_AFTER, self._sweeps.n_scans))
        new = self._map(after + np.flatnonzero(found.is_key)[:_KEYS], after, found, after)
        if self._agree_near(old, new, guesses) or not self._contradict(old, new, guesses):
            return None
        begins = after
        while begins > first and self._fits(self._after, new, begins - 1, after):
            begins -= 1
        while before + 1 < begins and self._fits(self._before, old, before + 1, first - 1):
            before += 1
        return Carry(before, begins)

    def _rolled(self, first: int, last: int) -> F64:
        """first_from_last by the odometry; NaN where it is missing."""
        pose = np.zeros(3)
        for step in self._motion[first + 1 : last + 1]:
            pose = compose(pose, step)
        return pose

    def _map(self, scans: I64, anchor: int, front: Registered, offset: int) -> LocalMap:
        """Local map of some scans in the frame of one; the rows of *front* begin with scan *offset*."""
        poses = between(front.poses[anchor - offset], front.poses[scans - offset])
        return self._collector.collect(anchor, scans, poses, self._front.twists)

    def _agree_at(self, old: LocalMap, new: LocalMap, guesses: Sequence[F64]) -> bool:
        """Whether two maps surely agree at one of some poses old_from_new."""
        self._before.draw(old)
        self._after.draw(new)
        return any(
            max(
                self._before.judge(new, guess).matched_of_seen,
                self._after.judge(old, inverse(guess)).matched_of_seen,
            )
            > _SURELY_AGREE_SHARE
            for guess in guesses
        )

    def _agree_near(self, old: LocalMap, new: LocalMap, guesses: Sequence[F64]) -> bool:
        """Whether two maps agree near one of some poses old_from_new, in what either of them sees of the other."""
        self._before.draw(old)
        self._after.draw(new)
        for guess in guesses:
            for fit in self._before.search(new, guess, _NEAR_M, _NEAR_RAD):
                error = between(guess, fit.pose)
                is_near = np.hypot(error[0], error[1]) < _NEAR_M and abs(error[2]) < _NEAR_RAD
                back = self._after.judge(old, inverse(fit.pose))
                if is_near and max(fit.matched_of_seen, back.matched_of_seen) > _AGREE_SHARE:
                    return True
        return False

    def _contradict(self, old: LocalMap, new: LocalMap, guesses: Sequence[F64]) -> bool:
        """Whether at each of some poses old_from_new a good part of one map stands in the other's free space.

        Maps of a place where little is seen do not agree, which tells nothing.
        """
        if min(len(old.points), len(new.points)) < _LEAST_POINTS:
            return False
        self._before.draw(old)
        self._after.draw(new)
        return all(
            max(
                self._before.judge(new, guess).in_free,
                self._after.judge(old, inverse(guess)).in_free,
            )
            > _IN_FREE_SHARE
            for guess in guesses
        )

    def _fits(self, easel: Easel, local_map: LocalMap, scan: int, anchor: int) -> bool:
        """Whether a scan fits on a local map where the odometry has it, seen from the map's anchor."""
        easel.draw(local_map)
        start = self._rolled(anchor, scan) if scan > anchor else inverse(self._rolled(scan, anchor))
        _, _, judged = easel.fit_scans(
            self._sweeps, self._rays, self._front.twists, np.array([scan]), start[None, :]
        )
        seen, matched = judged[0, SEEN], judged[0, MATCHED]
        return bool(seen >= _SCAN_SEEN and matched >= _SCAN_MATCHED * seen)
