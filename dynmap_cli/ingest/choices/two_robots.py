"""Two robots on one topic: odometry whose poses jump between two tracks is parted, sweeps that do so are refused.

Where one of them sends far fewer sweeps, that is said: such a one is seen alone, and again some sweeps later.
"""

from __future__ import annotations

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.poses import interpolate
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.merging import Columns
from dynmap_cli.ingest.choices.tracks import moving_tracks, places_of, poses_of
from dynmap_cli.ingest.raw.columns import ascends, spans
from dynmap_cli.ingest.raw.recording import RawRecording, file_name, sorted_by_stamp
from dynmap_cli.ingest.seen_motion.agreement import agreement
from dynmap_cli.ingest.seen_motion.turns import ReferenceLaser, ScanTurns

_JUMP_M, _BACK_SHARE = 1.0, 0.3
_LOOK_AHEAD = 4
_LEAST_JUMPS, _MOST_STEPS_PER_JUMP = 10, 20
_CLEARLY = 0.7
_CHANGED_M, LEAST_ALTERNATING, _LEAST_SCANS = 0.2, 0.3, 20
_FARTHEST_M, _MOST_ALIKE = 10.0, 0.9
_RETURNS_WITHIN, _OTHER_SHARE, _LEAST_RETURNING = 64, 0.7, 0.03
_MOST_LOOKED_AT, _LOOKED_AT_ONCE, _BEAMS_LOOKED_AT = 256, 16, 90


def part_tracks(recording: RawRecording, reference: ReferenceLaser | None) -> None:
    """Keep one of the two tracks between which poses jump: that which turns as the sweeps do, if that can be told.

    Poses are looked at in the order of their stamps: some reach a recorder late.
    """
    for name, source in moving_tracks(recording):
        places = places_of(source)
        order = None if ascends(source.stamps_ns) else np.argsort(source.stamps_ns, kind="stable")
        apart_m = _apart_m(places if order is None else places[order])
        source.give_back()
        if apart_m is None or reference is None:
            continue
        if order is not None:
            source.keep(order)
        poses = poses_of(source)
        is_first = _first_track(poses)
        off_rad = [
            _off_rad(reference.turns, source.stamps_ns[rows], poses[rows]) for rows in (is_first, ~is_first)
        ]
        better = int(off_rad[1] < off_rad[0])
        told = "it is not clear which is that of the robot with the laser, so neither is used"
        kept = np.zeros(is_first.size, dtype=bool)
        if off_rad[better] < _CLEARLY * off_rad[1 - better]:
            told = "the one that turns as the scans do is used"
            kept = ~is_first if better else is_first
        recording.warnings.append(
            f"{name}: its poses jump between two tracks, {apart_m:.1f} m apart in the median, as where two robots "
            f"publish on one topic; {told}"
        )
        source.keep(kept)
    recording.odometry = {name: one for name, one in recording.odometry.items() if one.stamps_ns.size}
    recording.transforms = {pair: one for pair, one in recording.transforms.items() if one.stamps_ns.size}


def _apart_m(places: F64) -> float | None:
    """How far tracks are apart between which places (n, 2) jump again and again; None where they do not."""
    n_steps = max(places.shape[0] - 1, 0)
    found = [
        rows.start
        + np.flatnonzero(np.hypot(*np.diff(places[rows.start : rows.stop + 1], axis=0).T) > _JUMP_M)
        for rows in spans(n_steps, places)
    ]
    jumps = np.concatenate(found) if found else np.zeros(0, dtype=np.int64)
    jumps = jumps[jumps < n_steps - _LOOK_AHEAD]
    if jumps.size < max(_LEAST_JUMPS, n_steps // _MOST_STEPS_PER_JUMP):
        return None
    away_m = [np.hypot(*(places[jumps + ahead] - places[jumps]).T) for ahead in range(1, _LOOK_AHEAD + 1)]
    is_back = np.min(away_m[1:], axis=0) < _BACK_SHARE * away_m[0]
    return float(np.median(away_m[0])) if np.mean(is_back) > 0.5 else None


def _first_track(poses: F64) -> B1:
    """(n,) which poses go on from the first one; each is of the track whose last pose is nearer."""
    places = poses[:, :2].tolist()
    result = np.zeros(len(places), dtype=bool)
    first, second = places[0], None
    for number, place in enumerate(places):
        to_first = np.hypot(place[0] - first[0], place[1] - first[1])
        if second is None:
            is_first = to_first <= _JUMP_M
        else:
            is_first = to_first <= np.hypot(place[0] - second[0], place[1] - second[1])
        result[number] = is_first
        if is_first:
            first = place
        else:
            second = place
    return result


def _off_rad(turns: ScanTurns, stamps_ns: I64, poses: F64) -> float:
    """What is left of the turns of the sweeps without those of a track; inf where that says nothing."""
    track = sorted_by_stamp(stamps_ns, poses)
    yaws = [interpolate(*track, at_ns)[:, 2] for at_ns in (turns.first_ns, turns.second_ns)]
    found = agreement(turns, (yaws[0], yaws[1]))
    return min(found.same_rad, found.opposite_rad)


def refuse_two_lasers(columns: Columns, recording: RawRecording) -> None:
    """Refuse sweeps that show two places in turn, and say where few of them do; some hundreds, evenly spread, tell.

    Raises
    ------
    LogError
    """
    n_scans, n_beams = columns.ranges_m.shape
    if n_scans < _LEAST_SCANS or (columns.laser != columns.laser[0]).any():
        return
    starts = np.linspace(0, n_scans - 4, min(_MOST_LOOKED_AT, n_scans - 3)).astype(np.int64)
    every = max(1, n_beams // _BEAMS_LOOKED_AT)
    n_alternating = n_returning = 0
    for first in range(0, starts.size, _LOOKED_AT_ONCE):
        looks = starts[first : first + _LOOKED_AT_ONCE, None] + np.arange(4)
        is_alternating = alternates(columns.ranges_m[looks, ::every], columns.geometry_index[looks])
        n_alternating += int(np.count_nonzero(is_alternating))
        n_returning += sum(
            _returns(columns.ranges_m[one : one + _RETURNS_WITHIN, ::every])
            for one in looks[is_alternating, 0].tolist()
        )
        # Of a mapped table a system may hold far more than the rows that were read.
        give_back(columns.ranges_m)
    share = n_alternating / starts.size
    if share > LEAST_ALTERNATING:
        msg = (
            f"{recording.name}: after {100 * share:.0f} % of the scans the next one shows another place and one of "
            "the two after it this one again, as where two robots or lasers publish on one topic under one frame, or "
            "the clock was set back while recording. Record each on a topic of its own and with a steady clock, or "
            "pass another --scan-topic."
        )
        raise LogError(msg)
    if n_returning > _LEAST_RETURNING * starts.size:
        recording.warnings.append(
            f"{file_name(recording.name)}: {100 * share:.0f} % of the scans show another place than those around them, "
            "and the same one again and again, as where a second robot or laser publishes on the topic now and then; "
            "they are used as they are. Record each on a topic of its own, or pass another --scan-topic"
        )


def _returns(ranges_m: F32) -> bool:
    """Whether the second of some sweeps (n, n_beams), unlike the first, is seen again later, between two unlike it.

    Most sweeps are like the next one: of sweeps that change at random any may be like another.
    """
    values = _clipped(ranges_m)
    change_m = np.median(np.abs(values - values[1]), axis=1)
    is_same, is_other = change_m < _BACK_SHARE * change_m[0], change_m > _OTHER_SHARE * change_m[0]
    step_m = np.median(np.abs(np.diff(values, axis=0)), axis=1)
    if np.median(step_m) >= _BACK_SHARE * change_m[0]:
        return False
    return bool((is_other[1:-2] & is_same[2:-1] & is_other[3:]).any())


def _clipped(ranges_m: F32) -> F32:
    """Ranges of which none is unknown or negative, or so far that it counts for more than others."""
    known_m = np.nan_to_num(ranges_m, nan=_FARTHEST_M, posinf=_FARTHEST_M)
    return np.clip(known_m, np.float32(0.0), np.float32(_FARTHEST_M))


def alternates(ranges_m: F32, geometry_index: I32) -> B1:
    """(n,) where of four sweeps (n, 4, n_beams) the first is much more like the third or fourth than the second.

    Sweeps of which nearly all beams have one value show no place, as where a laser drops out.
    """
    values = _clipped(ranges_m)
    change_m = np.median(np.abs(values[:, 1:] - values[:, :1]), axis=2)
    is_alike = geometry_index[:, 1:] == geometry_index[:, :1]
    next_m = np.where(is_alike[:, 0], change_m[:, 0], np.nan)
    later_m = np.where(is_alike[:, 1:], change_m[:, 1:], np.inf).min(axis=1)
    result = np.asarray((next_m > _CHANGED_M) & (later_m < _BACK_SHARE * next_m))
    if result.any():
        result[result] = _show_places(values[result, :2])
    return result


def _show_places(ranges_m: F32) -> B1:
    """(n,) where not nearly all beams of a sweep have one value, in any of some sweeps (n, n_sweeps, n_beams)."""
    is_usual = ranges_m == np.median(ranges_m, axis=2, keepdims=True)
    return np.asarray((is_usual.mean(axis=2) < _MOST_ALIKE).all(axis=1))
