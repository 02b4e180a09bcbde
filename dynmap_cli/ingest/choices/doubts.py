"""What in the times, sizes and poses of a recording cannot be right: dropped with a count, or said with numbers."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np

from dynmap_cli.arrays import F32, F64, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.free_space import kinds_of
from dynmap_cli.ingest.choices.merging import Columns
from dynmap_cli.ingest.choices.track_quality import known_jumps_m
from dynmap_cli.ingest.raw.columns import ascends, blocks_of, spans, steps_in
from dynmap_cli.ingest.raw.laser import RawLaser
from dynmap_cli.ingest.raw.plausible import LONGEST_RANGE_M
from dynmap_cli.ingest.raw.recording import RawRecording, StampedRows, file_name

_LONGEST_DRIVE_NS = 7 * 86_400 * 10**9
_LEAST_ON_CLOCK = 10
_MOST_BEAMS = 8
_LEAST_BEAMS = 3
"""A pose has three unknowns, and a beam tells one."""
_ZIGZAG, _ALIKE_RANGE_M = 1.1, 10.0
_CLOCK_SET_S, _LONG_PAUSE_S = 5.0, 60.0
_FROZEN_SCANS, _FROZEN_PATH_M = 100, 1.0


def drop_impossible(recording: RawRecording) -> None:
    """Drop sweeps that lie more than a week from most others, or have over eight times the beams of the middle one.

    Such a stamp or count comes from a clock that was set, or from a damaged message; one of them would stretch
    everything that is laid out over time or beams.
    """
    if not recording.lasers:
        return
    lasers = list(recording.lasers.values())
    groups = _clocks_of([laser.stamps_ns for laser in lasers])
    largest = max(range(len(groups)), key=lambda number: (groups[number].size, number))
    ordered = groups[largest]
    middle_ns = int(np.median(ordered[[(ordered.size - 1) // 2, ordered.size // 2]]))
    _note_clocks(groups, largest, recording)
    _drop_far_poses(recording, middle_ns)
    for laser in lasers:
        is_near = np.zeros(laser.n_scans, dtype=bool)
        for rows in spans(is_near.size, laser.stamps_ns):
            is_near[rows] = np.abs(laser.stamps_ns[rows] - middle_ns) <= _LONGEST_DRIVE_NS
        if not is_near.all():
            recording.dropped[
                f"scan on {laser.name} stamped more than a week from the others, as after a clock was set"
            ] += int(np.count_nonzero(~is_near))
            laser.keep(is_near)
        if laser.n_scans == 0:
            del recording.lasers[laser.name]
            continue
        lengths, counts = laser.lengths_counted
        middle = [(laser.n_scans - 1) // 2, laser.n_scans // 2]
        usual = int(np.median(lengths[np.searchsorted(np.cumsum(counts), middle, side="right")]))
        unusual = int(counts[lengths > _MOST_BEAMS * usual].sum())
        if unusual:
            recording.dropped[
                f"scan on {laser.name} with over {_MOST_BEAMS} times the usual {usual} beams"
            ] += unusual
            laser.keep(laser.n_beams <= _MOST_BEAMS * usual)
        _note_beam_intervals(recording, laser.name)
        laser.give_back()


def _drop_far_poses(recording: RawRecording, middle_ns: int) -> None:
    """Drop single poses and transforms that are stamped more than a week from most sweeps, where others are not."""
    sources: list[tuple[str, StampedRows]] = [
        (f"pose on {name}", one) for name, one in recording.odometry.items()
    ]
    sources += [
        (f"transform {parent} -> {child}", one)
        for (parent, child), one in recording.transforms.items()
        if not one.is_static
    ]
    for what, source in sources:
        is_near = np.abs(source.stamps_ns - middle_ns) <= _LONGEST_DRIVE_NS
        if is_near.any() and not is_near.all():
            source.keep(is_near)
            recording.dropped[f"{what} stamped more than a week from the scans"] += int(
                np.count_nonzero(~is_near)
            )


def _clocks_of(stamps_ns: Sequence[I64]) -> list[I64]:
    """Stamps of several lasers in order, parted where nothing is stamped for more than a week."""
    ordered = stamps_ns[0] if len(stamps_ns) == 1 else np.concatenate(stamps_ns)
    if not ascends(ordered):
        ordered = np.sort(ordered)
    is_far = [steps > _LONGEST_DRIVE_NS for steps in steps_in(ordered)]
    return np.split(ordered, np.flatnonzero(np.concatenate(is_far)) + 1 if is_far else [])


def _note_clocks(groups: Sequence[I64], used: int, recording: RawRecording) -> None:
    """Say which parts of a recording are on which clock, where one that is not used is more than a few odd stamps."""
    if all(group.size < _LEAST_ON_CLOCK for number, group in enumerate(groups) if number != used):
        return
    began = [f"{datetime.fromtimestamp(int(group[0]) // 10**9, UTC):%Y-%m-%d %H:%M:%S}" for group in groups]
    parts = [
        f"{group.size} scans from {when} UTC on"
        for group, when in zip(groups, began, strict=True)
        if group.size >= _LEAST_ON_CLOCK
    ]
    recording.warnings.append(
        f"{file_name(recording.name)}: the clock was set while it was made: it holds {' and '.join(parts)}, of which "
        f"those from {began[used]} on are used. Split the recording there to use the others"
    )


def note_damaged_pack(recording: RawRecording, why: str) -> None:
    """Say that what was read is only what could be unpacked of a damaged file."""
    stamps_ns = [one for laser in recording.lasers.values() for one in laser.stamps_ns]
    span_s = (max(stamps_ns) - min(stamps_ns)) * 1e-9 if stamps_ns else 0.0
    recording.damage.append(why)
    recording.warnings.append(
        f"{file_name(recording.name)}: {why}; recovered {recording.n_read} messages of this {recording.kind}, "
        f"up to t = {span_s:.1f} s"
    )


def _note_beam_intervals(recording: RawRecording, name: str) -> None:
    """Say where the time between beams is no duration."""
    intervals_s = recording.lasers[name].beam_interval_s
    broken = int(np.count_nonzero(np.isnan(intervals_s)))
    if broken:
        recording.warnings.append(
            f"{name}: {broken} of {len(intervals_s)} scans have a time_increment that is negative, not a number or "
            "over a minute per sweep; it is taken from the others, or as 0"
        )


def note_stamps(lasers: Sequence[RawLaser], recording: RawRecording) -> None:
    """Say how far stamps go back, and how long nothing was recorded: both happen when a clock is set."""
    for laser in lasers:
        back_s = -float(min((steps.min() for steps in steps_in(laser.stamps_ns)), default=0)) * 1e-9
        ordered = laser.stamps_ns if back_s <= 0.0 else np.sort(laser.stamps_ns)
        pause_s = float(max((steps.max() for steps in steps_in(ordered)), default=0)) * 1e-9
        if back_s > _CLOCK_SET_S:
            recording.warnings.append(
                f"{laser.name}: from one scan to the next the stamps go back by up to {back_s:.1f} s, as where a clock "
                "was set; scans are in the order of their stamps. Split the recording there"
            )
        if pause_s > _LONG_PAUSE_S:
            recording.warnings.append(f"{laser.name}: no scans for up to {pause_s:.1f} s")


def note_few_beams(lasers: Sequence[RawLaser], recording: RawRecording, *, has_odometry: bool) -> None:
    """Say how many sweeps have fewer beams than a pose has unknowns.

    Raises
    ------
    LogError
        If these are all sweeps, and without odometry nothing says where the robot was.
    """
    few = {}
    for laser in lasers:
        lengths, counts = laser.lengths_counted
        few[laser.name] = int(counts[lengths < _LEAST_BEAMS].sum())
    n_scans = sum(laser.n_scans for laser in lasers)
    if not has_odometry and sum(few.values()) == n_scans:
        msg = (
            f"{recording.name}: each of the {n_scans} scans has fewer than {_LEAST_BEAMS} beams, too few to find a "
            "pose from, and there is no odometry. Pass a recording with odometry, or of a laser that sweeps."
        )
        raise LogError(msg)
    for laser in lasers:
        if few[laser.name]:
            recording.warnings.append(
                f"{laser.name}: {few[laser.name]} of {laser.n_scans} scans have fewer than {_LEAST_BEAMS} beams, too "
                f"few to find a pose from; {'odometry' if has_odometry else 'the other scans'} alone can say "
                "where the robot was"
            )


def note_shared_stamps(columns: Columns, recording: RawRecording) -> None:
    """Say how many sweeps share their stamp with another one of the same laser, for they are not copies of it."""
    is_same = columns.stamps_ns[1:] == columns.stamps_ns[:-1]
    is_same &= columns.laser[1:] == columns.laser[:-1]
    shared = int(np.count_nonzero(is_same))
    if shared:
        recording.warnings.append(f"{shared} scans have the stamp of the scan before but other ranges")


def note_odometry(columns: Columns, poses: F64, recording: RawRecording) -> None:
    """Say where the odometry jumps farther than anything drives."""
    found_m = known_jumps_m(columns.stamps_ns, poses)
    if found_m.size:
        often = "once" if found_m.size == 1 else f"{found_m.size} times"
        recording.warnings.append(
            f"the odometry jumps {often} between one scan and the next, by up to {found_m.max():.1f} m: "
            "it was reset or is damaged; pass --odom to choose another, or none"
        )


def refuse_frozen(columns: Columns, path_m: float, name: str) -> None:
    """Refuse many sweeps of which each is a copy of the first, with returns, while the odometry moves.

    Raises
    ------
    LogError
    """
    first = columns.ranges_m[:1]
    is_long = path_m >= _FROZEN_PATH_M and columns.stamps_ns.size >= _FROZEN_SCANS
    _, shape = columns.geometries[columns.geometry_index[0]]
    is_return, _ = kinds_of(first, shape.range_min_m, min(shape.range_max_m, LONGEST_RANGE_M))
    if not is_long or not is_return.any():
        return
    for rows in blocks_of(columns.ranges_m):
        block = columns.ranges_m[rows]
        if not ((block == first) | (np.isnan(block) & np.isnan(first))).all():
            return
        give_back(columns.ranges_m)
    msg = (
        f"{name}: all {columns.stamps_ns.size} scans have the same ranges while the odometry drives {path_m:.1f} m, as "
        "where the driver of the laser hangs. Record it again, or pass another --scan-topic."
    )
    raise LogError(msg)


def note_track(recording: RawRecording, source: str) -> None:
    """Say what is wrong with the stamps of an odometry that comes in messages or lines of its own."""
    track = recording.odometry.get(source)
    if track is None or source in recording.lasers:
        return
    backward = repeated = 0
    for steps_ns in steps_in(track.stamps_ns):
        backward += int(np.count_nonzero(steps_ns < 0))
        repeated += int(np.count_nonzero(steps_ns == 0))
    if backward or repeated:
        recording.warnings.append(
            f"odometry {source}: of {track.stamps_ns.size} poses {backward} were stamped before their predecessor and "
            f"{repeated} like it; they were sorted, and of equal stamps the first pose counts"
        )


def stamps_jump(columns: Columns, out_of_order: int, recording: RawRecording) -> bool:
    """Whether consecutive sweeps are clearly more alike in the order of recording than along their stamps; says so."""
    if not out_of_order or len(columns.geometries) > 1:
        return False
    recorded = np.argsort(columns.reading_index, kind="stable")
    along_stamps = _mean_change_m(columns.ranges_m, np.arange(recorded.size))
    as_recorded = _mean_change_m(columns.ranges_m, recorded)
    jump = along_stamps > _ZIGZAG * as_recorded
    if jump:
        recording.warnings.append(
            f"from scan to scan the ranges change by {along_stamps:.3f} m along the stamps but by {as_recorded:.3f} m "
            "in the order of recording: some stamps are wrong by more than a scan; the order of recording is followed"
        )
    return jump


def _mean_change_m(ranges_m: F32, order: I64) -> float:
    """Mean over the scans, in an order (n,), of the median change of a beam since the scan before."""
    changes_m = []
    for rows in blocks_of(ranges_m):
        block = ranges_m[order[rows.start : rows.stop + 1]]
        clipped = np.minimum(np.nan_to_num(block, nan=_ALIKE_RANGE_M), _ALIKE_RANGE_M)
        changes_m.append(np.median(np.abs(np.diff(clipped, axis=0)), axis=1))
        give_back(ranges_m)
    return float(np.concatenate(changes_m).mean())
