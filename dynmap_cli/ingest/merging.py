"""Recordings -> drives; those of one drive -> one; sweeps of all used lasers -> columns in time order."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.scans import ScanLog, join_drives
from dynmap_cli.errors import LogError
from dynmap_cli.ingest.clocks import UNDATED_BEFORE_NS
from dynmap_cli.ingest.raw import RawLaser, RawOdometry, RawRecording, RawTransform, ScanShape

_OVERLAP_S = 1.0
_JUMP_M, _JUMP_M_PER_S = 1.0, 2.0
_ORIGIN, _LEFT_ORIGIN_M = 0.01, 0.3
_ABSURD_SWEEP = 2.0
_AFTER_S = 61.0
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
        if _stamps(earlier) == _stamps(later):
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


def _stamps(recording: RawRecording) -> dict[str, list[int]]:
    """Stamps of the sweeps of each laser."""
    return {name: laser.stamps_ns for name, laser in recording.lasers.items()}


def _append(joined: RawRecording, recording: RawRecording, number: int) -> None:
    """Add the content of one recording."""
    for name, laser in recording.lasers.items():
        into = joined.lasers.setdefault(
            name, RawLaser(name, laser.frame, robot_from_sensor=laser.robot_from_sensor)
        )
        into.stamps_ns += laser.stamps_ns
        into.logged_ns += laser.logged_ns
        into.ranges_m += laser.ranges_m
        into.shapes += laser.shapes
        into.beam_interval_s += laser.beam_interval_s
        into.recording += [number] * laser.n_scans
    for name, track in recording.odometry.items():
        kept = joined.odometry.setdefault(name, RawOdometry(name, track.frame, track.child))
        kept.stamps_ns += track.stamps_ns
        kept.poses += track.poses
    for pair, transform in recording.transforms.items():
        edge = joined.transforms.setdefault(pair, RawTransform(transform.is_static))
        edge.stamps_ns += transform.stamps_ns
        edge.values += transform.values
    joined.topics += recording.topics
    joined.dropped += recording.dropped
    joined.damage += recording.damage
    joined.warnings += recording.warnings
    joined.n_read += recording.n_read


def add_drives(earlier: ScanLog, later: ScanLog) -> ScanLog:
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
    return join_drives([earlier, later])


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
        self.stamps_ns = self.stamps_ns[scans]
        self.ranges_m = self.ranges_m[scans]
        self.laser = self.laser[scans]
        self.geometry_index = self.geometry_index[scans]
        self.recording_index = self.recording_index[scans]
        self.reading_index = self.reading_index[scans]


def columns_of(lasers: Sequence[RawLaser], dropped: Counter[str]) -> tuple[Columns, int]:
    """Bring the sweeps of all lasers into time order; second result: how many were stamped before their predecessor."""
    table: dict[tuple[int, ScanShape], int] = {}
    stamps, numbers, geometry, recording = [], [], [], []
    backwards = 0
    for number, laser in enumerate(lasers):
        stamps.append(np.array(laser.stamps_ns, dtype=np.int64))
        backwards += int(np.count_nonzero(np.diff(stamps[-1]) < 0))
        numbers.append(np.full(laser.n_scans, number, dtype=np.int32))
        geometry.append([table.setdefault((number, shape), len(table)) for shape in laser.shapes])
        recording.append(np.array(laser.recording, dtype=np.int32))
    order = np.argsort(np.concatenate(stamps), kind="stable")
    geometries = list(table)
    index = np.concatenate([np.array(part, dtype=np.int32) for part in geometry])[order]
    columns = Columns(
        np.concatenate(stamps)[order],
        _padded([sweep for laser in lasers for sweep in laser.ranges_m], order),
        np.concatenate(numbers)[order],
        index,
        np.concatenate(recording)[order],
        geometries,
        _beam_intervals(lasers, geometries),
        order,
    )
    repeated = _repeated(columns)
    if repeated.any():
        dropped["scan that repeats stamp and ranges of another"] += int(repeated.sum())
        columns.keep(~repeated)
    return columns, backwards


def _padded(sweeps: list[F32], order: I64) -> F32:
    """Stack sweeps (n, widest) in the given order; missing beams are NaN."""
    widest = max(sweep.size for sweep in sweeps)
    result = np.full((len(sweeps), widest), np.nan, dtype=np.float32)
    for row, number in enumerate(order.tolist()):
        sweep = sweeps[number]
        result[row, : sweep.size] = sweep
    return result


def _repeated(columns: Columns) -> B1:
    """(n,) sweeps that have stamp, geometry and ranges of the one before."""
    repeated = np.zeros(columns.stamps_ns.size, dtype=bool)
    for row in np.flatnonzero(np.diff(columns.stamps_ns) == 0) + 1:
        repeated[row] = columns.geometry_index[row] == columns.geometry_index[row - 1] and np.array_equal(
            columns.ranges_m[row], columns.ranges_m[row - 1], equal_nan=True
        )
    return repeated


def _beam_intervals(lasers: Sequence[RawLaser], geometries: list[tuple[int, ScanShape]]) -> F64:
    """Median time between beams of each geometry; 0 where a sweep would last longer than two sweep periods."""
    result = np.zeros(len(geometries))
    rows = {geometry: row for row, geometry in enumerate(geometries)}
    for number, laser in enumerate(lasers):
        period_s = period_s_of(np.array(laser.stamps_ns, dtype=np.int64))
        values: dict[ScanShape, list[float]] = {}
        for shape, interval_s in zip(laser.shapes, laser.beam_interval_s, strict=True):
            if math.isfinite(interval_s):
                values.setdefault(shape, []).append(interval_s)
        for shape, intervals in values.items():
            interval_s = float(np.median(intervals))
            if interval_s * shape.n_beams <= _ABSURD_SWEEP * period_s:
                result[rows[number, shape]] = interval_s
    return result


def period_s_of(stamps_ns: I64) -> float:
    """Median time between sweeps, seconds; 0 with fewer than two."""
    return float(np.median(np.abs(np.diff(np.sort(stamps_ns))))) * 1e-9 if stamps_ns.size > 1 else 0.0


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
