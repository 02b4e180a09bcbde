"""Recordings -> drives; those of one drive -> one; sweeps of all used lasers -> columns in time order."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.mapped import give_back
from dynmap_cli.domain.scans import ScanLog, join_drives
from dynmap_cli.errors import LogError
from dynmap_cli.files.tables import new_table
from dynmap_cli.ingest.choices.clocks import UNDATED_BEFORE_NS
from dynmap_cli.ingest.raw.columns import ascends, blocks_of, counts_of, kept_rows, picked, steps_in
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.raw.recording import RawOdometry, RawRecording, RawTransform, topic_of

_OVERLAP_S = 1.0
_JUMP_M, _JUMP_M_PER_S = 1.0, 2.0
_ORIGIN, _LEFT_ORIGIN_M = 0.01, 0.3
_ABSURD_SWEEP = 2.0
_AFTER_S = 61.0
Number = TypeVar("Number", bound=np.generic)
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Drive:
    """Recordings that continue one another.

    Attributes
    ----------
    recordings : tuple of RawRecording
        In the order of their first sweep.
    why_apart : str
        Why it does not continue what was recorded before; "" for the first.
    """

    recordings: tuple[RawRecording, ...]
    why_apart: str = ""

    def split(self, first: int, why_apart: str) -> tuple[Drive, Drive]:
        """The recordings before one, and those from it on as a drive of their own."""
        return Drive(self.recordings[:first], self.why_apart), Drive(self.recordings[first:], why_apart)


def find_drives(recordings: Sequence[RawRecording], max_gap_s: float) -> list[Drive]:
    """Sort recordings by their first sweep, and put those that continue one another into one drive.

    Raises
    ------
    LogError
        If two were made at the same time.
    """
    ordered = sorted(recordings, key=lambda recording: recording.span_ns)
    drives = [Drive((ordered[0],))]
    for earlier, later in pairwise(ordered):
        why = _why_apart(earlier, later, max_gap_s)
        if why:
            drives.append(Drive((later,), why))
        else:
            drives[-1] = Drive((*drives[-1].recordings, later), drives[-1].why_apart)
    return drives


def join_recordings(drive: Drive, others: Sequence[Drive]) -> RawRecording:
    """Put the recordings of a drive into one.

    Static transforms of all files serve all of them, since recorders write them into the first file only; those of
    other drives serve where a drive has none.
    """
    if len(drive.recordings) == 1:
        joined = drive.recordings[0]
    else:
        joined = RawRecording(
            ", ".join(recording.name for recording in drive.recordings), drive.recordings[0].kind
        )
        for number, recording in enumerate(drive.recordings):
            _append(joined, recording, number)
    for other in others:
        for recording in other.recordings:
            for pair, transform in recording.transforms.items():
                if transform.is_static:
                    joined.transforms.setdefault(pair, transform)
    return joined


def _why_apart(earlier: RawRecording, later: RawRecording, max_gap_s: float) -> str:
    """Why a recording does not continue the one before; "" where it does.

    Raises
    ------
    LogError
        If they were made at the same time.
    """
    gap_s = (later.span_ns[0] - earlier.span_ns[1]) * 1e-9
    if gap_s < -_OVERLAP_S:
        if _have_same_stamps(earlier, later):
            msg = f"{earlier.name} and {later.name}: the same recording. Pass it once."
            raise LogError(msg)
        raise _at_the_same_time(earlier.name, later.name, -gap_s)
    frames = [
        {(laser.name, laser.frame) for laser in recording.lasers.values()} for recording in (earlier, later)
    ]
    if not frames[0] & frames[1]:
        return "no laser in common with the recording before"
    if gap_s > max_gap_s:
        return f"{gap_s:.0f} s after the recording before (at most {max_gap_s:.0f} s, ingest.max_gap_s)"
    return ""


def _have_same_stamps(a: RawRecording, b: RawRecording) -> bool:
    """Whether two recordings have the same lasers, and these the same stamps."""
    return a.lasers.keys() == b.lasers.keys() and all(
        np.array_equal(laser.stamps_ns, b.lasers[name].stamps_ns) for name, laser in a.lasers.items()
    )


def _append(joined: RawRecording, recording: RawRecording, number: int) -> None:
    """Add the content of one recording."""
    for name, laser in recording.lasers.items():
        into = joined.laser(topic_of(name), laser.frame)
        if into.n_scans == 0:
            into.robot_from_sensor = laser.robot_from_sensor
        into.append(laser, number)
    for name, track in recording.odometry.items():
        kept = joined.odometry.setdefault(name, RawOdometry(name, track.frame, track.child))
        kept.add_many(track.stamps_ns, track.logged_ns, track.poses)
    for pair, transform in recording.transforms.items():
        edge = joined.transforms.setdefault(pair, RawTransform(transform.is_static))
        edge.add_many(transform.stamps_ns, transform.logged_ns, transform.values)
    joined.topics += recording.topics
    joined.dropped += recording.dropped
    joined.damage += recording.damage
    joined.warnings += recording.warnings
    joined.notes += recording.notes
    joined.n_read += recording.n_read


def joined_logs(logs: Sequence[ScanLog], folder: Path | None) -> ScanLog:
    """The sweeps of several drives as one log, whose ranges are put on the disk of *folder* where they are many."""
    if len(logs) == 1:
        return logs[0]
    table = new_table(sum(log.n_scans for log in logs), max(log.n_beams for log in logs), folder)
    return join_drives(logs, table)


def add_drives(earlier: ScanLog, later: ScanLog, folder: Path | None = None) -> ScanLog:
    """Put the drives of a log that is there and of one that was read now into one.

    Stamps without a date that overlap are moved: the later one comes after what is there.

    Raises
    ------
    LogError
        If two were made at the same time.
    """
    if later.stamps_ns[0] <= earlier.stamps_ns[-1] < UNDATED_BEFORE_NS:
        shift = earlier.stamps_ns[-1] - later.stamps_ns[0] + round(_AFTER_S * 1e9)
        later = replace(later, stamps_ns=later.stamps_ns + shift)
        _log.warning(
            "%s: its stamps have no date and overlap with those of the run; taken as made after it: %.3f s were added "
            "to its stamps",
            ", ".join(later.recordings),
            shift * 1e-9,
        )
    for number in range(earlier.n_drives):
        stamps = earlier.stamps_ns[earlier.drive_index == number]
        overlap_s = (min(stamps[-1], later.stamps_ns[-1]) - max(stamps[0], later.stamps_ns[0])) * 1e-9
        if overlap_s > _OVERLAP_S:
            raise _at_the_same_time(
                ", ".join(earlier.recordings_of(number)), ", ".join(later.recordings), overlap_s
            )
    return joined_logs([earlier, later], folder)


def _at_the_same_time(earlier: str, later: str, overlap_s: float) -> LogError:
    """One line for recordings of which one cannot come after the other."""
    return LogError(
        f"{earlier} and {later}: they overlap in time by {overlap_s:.1f} s. Recordings of one site are made one after "
        "another; leave one of them out."
    )


@dataclass(slots=True)
class Columns:
    """Sweeps of all used lasers in time order, ranges as recorded.

    Attributes
    ----------
    stamps_ns : (n,) int64
    ranges_m : (n, n_beams) float32
        NaN where a geometry has fewer beams.
    laser : (n,) int32
        Which of the used lasers.
    geometry_index : (n,) int32
    recording_index : (n,) int32
    geometries : list of (laser number, ScanShape)
    beam_interval_s : (n_geometries,) float64
    """

    stamps_ns: I64
    ranges_m: F32
    laser: I32
    geometry_index: I32
    recording_index: I32
    geometries: list[tuple[int, ScanShape]]
    beam_interval_s: F64
    reading_index: I64

    def keep(self, scans: B1 | slice) -> None:
        """Forget all other sweeps."""
        self.ranges_m = kept_rows(self.ranges_m, scans)
        self.stamps_ns = self.stamps_ns[scans]
        self.laser = self.laser[scans]
        self.geometry_index = self.geometry_index[scans]
        self.recording_index = self.recording_index[scans]
        self.reading_index = self.reading_index[scans]


def columns_of(
    lasers: Sequence[RawLaser], dropped: Counter[str], folder: Path | None = None
) -> tuple[Columns, int]:
    """Bring the sweeps of all lasers into time order; second result: how many were stamped before their predecessor.

    Parameters
    ----------
    lasers : sequence of RawLaser
        A single one may lose its ranges to the columns.
    dropped : Counter
        Copies of sweeps are added to it.
    folder : Path or None
        On which disk ranges lie that do not fit into memory.
    """
    table: dict[tuple[int, ScanShape], int] = {}
    numbers, geometry = [], []
    backwards = 0
    for number, laser in enumerate(lasers):
        backwards += sum(int(np.count_nonzero(steps < 0)) for steps in steps_in(laser.stamps_ns))
        numbers.append(np.full(laser.n_scans, number, dtype=np.int32))
        _, first = np.unique(laser.shape_index, return_index=True)
        rows = np.zeros(len(laser.shape_table), dtype=np.int32)
        for shape in laser.shape_index[np.sort(first)].tolist():
            rows[shape] = table.setdefault((number, laser.shape_table[shape]), len(table))
        geometry.append(rows[laser.shape_index])
    stamps_ns = _joined([laser.stamps_ns for laser in lasers])
    order = np.argsort(stamps_ns, kind="stable")
    geometries = list(table)
    columns = Columns(
        picked(stamps_ns, order),
        _in_order(lasers, order, folder),
        picked(_joined(numbers), order),
        picked(_joined(geometry), order),
        picked(_joined([laser.recording for laser in lasers]), order),
        geometries,
        _beam_intervals(lasers, geometries),
        order,
    )
    repeated = _repeated(columns)
    if repeated.any():
        dropped["scan that repeats stamp and ranges of another"] += int(repeated.sum())
        columns.keep(~repeated)
    return columns, backwards


def _joined(columns: Sequence[NDArray[Number]]) -> NDArray[Number]:
    """Columns one after another; a single one itself, which may be mapped from a file."""
    return columns[0] if len(columns) == 1 else np.concatenate(columns)


def _in_order(lasers: Sequence[RawLaser], order: I64, folder: Path | None) -> F32:
    """Ranges (n, widest) of all lasers, one after the other, in the given order; missing beams are NaN."""
    if len(lasers) == 1 and all((steps == 1).all() for steps in steps_in(order)):
        taken = lasers[0].taken_ranges()
        if taken is not None:
            return taken
    ends = np.cumsum([laser.n_scans for laser in lasers])
    widest = max(int(laser.lengths_counted[0][-1]) for laser in lasers)
    table = new_table(order.size, widest, folder)
    for rows in blocks_of(table):
        numbers = order[rows]
        block = np.full((numbers.size, widest), np.nan, dtype=np.float32)
        owners = np.searchsorted(ends, numbers, side="right")
        for owner, laser in enumerate(lasers):
            own = owners == owner
            before = int(ends[owner]) - laser.n_scans
            if own.all():
                laser.fill(block, numbers - before)
            elif own.any():
                part = np.full((int(np.count_nonzero(own)), widest), np.nan, dtype=np.float32)
                laser.fill(part, numbers[own] - before)
                block[own] = part
        table[rows] = block
        give_back(table)
    return table


def _repeated(columns: Columns) -> B1:
    """(n,) sweeps that have stamp, geometry and ranges of the one before."""
    repeated = np.zeros(columns.stamps_ns.size, dtype=bool)
    for row in np.flatnonzero(columns.stamps_ns[1:] == columns.stamps_ns[:-1]) + 1:
        repeated[row] = columns.geometry_index[row] == columns.geometry_index[row - 1] and np.array_equal(
            columns.ranges_m[row], columns.ranges_m[row - 1], equal_nan=True
        )
    return repeated


def _beam_intervals(lasers: Sequence[RawLaser], geometries: list[tuple[int, ScanShape]]) -> F64:
    """Median time between beams of each geometry; 0 where a sweep would last longer than two sweep periods."""
    result = np.zeros(len(geometries))
    rows = {geometry: row for row, geometry in enumerate(geometries)}
    for number, laser in enumerate(lasers):
        period_s = period_s_of(laser.stamps_ns)
        known = np.isfinite(laser.beam_interval_s)
        for shape in np.flatnonzero(counts_of(laser.shape_index, len(laser.shape_table))).tolist():
            intervals_s = laser.beam_interval_s[known & (laser.shape_index == shape)]
            if not intervals_s.size:
                continue
            interval_s = float(np.median(intervals_s, overwrite_input=True))
            if interval_s * laser.shape_table[shape].n_beams <= _ABSURD_SWEEP * period_s:
                result[rows[number, laser.shape_table[shape]]] = interval_s
    return result


def period_s_of(stamps_ns: I64) -> float:
    """Median time between sweeps, seconds, of which those of one stamp count once; 0 with fewer than two."""
    steps_ns = pauses_ns(stamps_ns)
    return float(np.median(steps_ns, overwrite_input=True)) * 1e-9 if steps_ns.size else 0.0


def pauses_ns(stamps_ns: I64) -> I64:
    """Times (m,) between sweeps, given in any order, of which those of one stamp count once."""
    ordered = stamps_ns if ascends(stamps_ns) else np.sort(stamps_ns)
    result = np.empty(max(ordered.size - 1, 0), dtype=np.int64)
    count = 0
    for steps in steps_in(ordered):
        positive = steps[steps > 0]
        result[count : count + positive.size] = positive
        count += positive.size
    return result[:count]


def find_restart(recording_index: I32, stamps_ns: I64, odometry: F64) -> tuple[int, str] | None:
    """First recording of a drive in which the odometry was started anew, and how that was seen; None = nowhere.

    Parameters
    ----------
    recording_index : (n,) int32
        Which recording of the drive a sweep is from.
    stamps_ns : (n,) int64
    odometry : (n, 3) float64
    """
    for row in np.flatnonzero(np.diff(recording_index) != 0):
        before, after = odometry[row], odometry[row + 1]
        step_m = float(np.hypot(*(after[:2] - before[:2])))
        gap_s = float(stamps_ns[row + 1] - stamps_ns[row]) * 1e-9
        if step_m > _JUMP_M + _JUMP_M_PER_S * gap_s:
            return int(recording_index[row + 1]), f"the odometry jumps by {step_m:.1f} m before it"
        starts_at_origin = bool(np.abs(after).max() < _ORIGIN)
        if starts_at_origin and step_m > _LEFT_ORIGIN_M:
            return int(recording_index[row + 1]), "its odometry starts at the origin again"
    return None
