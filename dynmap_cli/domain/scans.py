"""What a recording is after it was read: sweeps of one or several lasers, as parallel arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.mapped import copied_rows, give_back
from dynmap_cli.domain.poses import transform_points

_ROWS_AT_ONCE = 1024


@dataclass(frozen=True, slots=True)
class ScanLog:
    """All sweeps of one or several recordings, in time order.

    Attributes
    ----------
    stamps_ns : (n_scans,) int64
        Header stamp, the time of the first beam; nanoseconds, ascending.
    ranges_m : (n_scans, n_beams) float32
        Distance along each beam in metres; +inf = nothing within reach, NaN = no measurement (REP 117).
    odometry : (n_scans, 3) float64
        odom_from_robot at the stamp: x, y in metres, yaw in radians; rows of NaN where there is none.
    geometry_index : (n_scans,) int32
        Which row of the geometry table a sweep was made with.
    bearings_rad : (n_geometries, n_beams) float64
        Direction of each beam in the sensor frame, counter-clockwise from +x; NaN where a geometry has
        fewer beams.
    sensor_poses : (n_geometries, 3) float64
        robot_from_sensor.
    range_limits_m : (n_geometries, 2) float64
        Shortest and longest distance the sensor measures.
    beam_interval_s : (n_geometries,) float64
        Time from one beam to the next, 0 where the recording does not say; negative where the sweep ran from the
        last beam to the first.
    recording_index : (n_scans,) int32
        Which of *recordings* a sweep came from.
    recordings : tuple of str
        File or folder names, in order.
    arrival_index : (n_scans,) int32
        Rank of a sweep in the order in which the sweeps were made. It differs from the order of the stamps
        only where the recording's clock is seen to jump about.
    drive_of_recording : (n_recordings,) int32
        Which drive each of *recordings* is a part of: ascending, without gaps. A drive has one start, and its
        odometry runs through; between two drives nobody knows how the robot moved.
    first_beam_s : (n_geometries,) float64
        When the first beam is made after the stamp: 0, or negative where sweeps are stamped at their end.
    """

    stamps_ns: I64
    ranges_m: F32
    odometry: F64
    geometry_index: I32
    bearings_rad: F64
    sensor_poses: F64
    range_limits_m: F64
    beam_interval_s: F64
    recording_index: I32
    recordings: tuple[str, ...]
    arrival_index: I32 = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    drive_of_recording: I32 = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    first_beam_s: F64 = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Check shapes and order against each other, and freeze the arrays."""
        n_scans, n_beams = self.ranges_m.shape
        n_geometries = self.sensor_poses.shape[0]
        if self.arrival_index.size == 0:
            object.__setattr__(self, "arrival_index", np.arange(n_scans, dtype=np.int32))
        if self.drive_of_recording.size == 0:
            object.__setattr__(self, "drive_of_recording", np.zeros(len(self.recordings), dtype=np.int32))
        if self.first_beam_s.size == 0:
            object.__setattr__(self, "first_beam_s", np.zeros(n_geometries))
        expected = {
            "first_beam_s": (n_geometries,),
            "arrival_index": (n_scans,),
            "drive_of_recording": (len(self.recordings),),
            "stamps_ns": (n_scans,),
            "odometry": (n_scans, 3),
            "geometry_index": (n_scans,),
            "recording_index": (n_scans,),
            "bearings_rad": (n_geometries, n_beams),
            "sensor_poses": (n_geometries, 3),
            "range_limits_m": (n_geometries, 2),
            "beam_interval_s": (n_geometries,),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                msg = f"{name} is {getattr(self, name).shape}, but ranges_m {self.ranges_m.shape} asks for {shape}"
                raise ValueError(msg)
        if bool((self.stamps_ns[1:] < self.stamps_ns[:-1]).any()):
            msg = "stamps_ns must ascend"
            raise ValueError(msg)
        if (
            n_scans
            and not 0 <= int(self.geometry_index.min()) <= int(self.geometry_index.max()) < n_geometries
        ):
            msg = f"geometry_index points outside the {n_geometries} geometries"
            raise ValueError(msg)
        for column in fields(self):
            value = getattr(self, column.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @property
    def n_scans(self) -> int:
        """Number of sweeps."""
        return int(self.ranges_m.shape[0])

    @property
    def n_beams(self) -> int:
        """Beams of the widest geometry."""
        return int(self.ranges_m.shape[1])

    @property
    def has_odometry(self) -> B1:
        """(n_scans,) whether a sweep has an odometry pose."""
        return np.asarray(np.isfinite(self.odometry).all(axis=1))

    @property
    def n_drives(self) -> int:
        """Number of drives, also of those of which no sweep is left."""
        return int(self.drive_of_recording.max(initial=0)) + 1

    @property
    def drive_index(self) -> I32:
        """(n_scans,) which drive a sweep belongs to."""
        return np.asarray(self.drive_of_recording[self.recording_index])

    def recordings_of(self, drive: int) -> tuple[str, ...]:
        """Names of the recordings of one drive."""
        return tuple(
            name
            for name, number in zip(self.recordings, self.drive_of_recording, strict=True)
            if number == drive
        )

    def select(self, scans: I64 | B1 | slice) -> ScanLog:
        """Keep some of the sweeps, in their order; those of a slice stay where they are, others are in memory."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[scans],
            ranges_m=self.ranges_m[scans] if isinstance(scans, slice) else copied_rows(self.ranges_m, scans),
            odometry=self.odometry[scans],
            geometry_index=self.geometry_index[scans],
            recording_index=self.recording_index[scans],
            arrival_index=np.argsort(np.argsort(self.arrival_index[scans], kind="stable")).astype(np.int32),
        )


def single_laser_log(
    stamps_ns: I64,
    ranges_m: F32,
    bearings_rad: F64,
    odometry: F64,
    *,
    sensor_pose: Sequence[float] = (0.0, 0.0, 0.0),
    range_limits_m: tuple[float, float] = (0.0, 30.0),
    beam_interval_s: float = 0.0,
    recording: str = "recording",
) -> ScanLog:
    """Make a `ScanLog` of one laser that never moves on the robot."""
    n_scans = ranges_m.shape[0]
    return ScanLog(
        stamps_ns=np.asarray(stamps_ns, dtype=np.int64),
        ranges_m=np.asarray(ranges_m, dtype=np.float32),
        odometry=np.asarray(odometry, dtype=np.float64),
        geometry_index=np.zeros(n_scans, dtype=np.int32),
        bearings_rad=np.asarray(bearings_rad, dtype=np.float64)[None, :],
        sensor_poses=np.asarray([sensor_pose], dtype=np.float64),
        range_limits_m=np.asarray([range_limits_m], dtype=np.float64),
        beam_interval_s=np.asarray([beam_interval_s], dtype=np.float64),
        recording_index=np.zeros(n_scans, dtype=np.int32),
        recordings=(recording,),
    )


def join_drives(drives: Sequence[ScanLog], table_m: F32 | None = None) -> ScanLog:
    """Put the sweeps of several drives into one log, in time order; each keeps its own geometries.

    Parameters
    ----------
    drives : sequence of ScanLog
    table_m : (n_scans, n_beams) float32, optional
        Where the ranges of all are put, which may be mapped from a file.
    """
    if len(drives) == 1:
        return drives[0]
    n_beams = max(log.n_beams for log in drives)
    stamps = np.concatenate([log.stamps_ns for log in drives])
    order = np.argsort(stamps, kind="stable")
    made = np.concatenate(
        _after_one_another([log.arrival_index for log in drives], [log.n_scans for log in drives])
    )
    geometries = [log.sensor_poses.shape[0] for log in drives]
    return ScanLog(
        stamps_ns=stamps[order],
        ranges_m=_joined_ranges(
            drives, order, np.empty((order.size, n_beams), np.float32) if table_m is None else table_m
        ),
        odometry=np.concatenate([log.odometry for log in drives])[order],
        geometry_index=np.concatenate(_after_one_another([log.geometry_index for log in drives], geometries))[
            order
        ],
        bearings_rad=np.concatenate([_widened(log.bearings_rad, n_beams) for log in drives]),
        sensor_poses=np.concatenate([log.sensor_poses for log in drives]),
        range_limits_m=np.concatenate([log.range_limits_m for log in drives]),
        beam_interval_s=np.concatenate([log.beam_interval_s for log in drives]),
        recording_index=np.concatenate(
            _after_one_another(
                [log.recording_index for log in drives], [len(log.recordings) for log in drives]
            )
        )[order],
        recordings=tuple(name for log in drives for name in log.recordings),
        arrival_index=made[order],
        drive_of_recording=np.concatenate(
            _after_one_another([log.drive_of_recording for log in drives], [log.n_drives for log in drives])
        ),
    )


def _joined_ranges(drives: Sequence[ScanLog], order: I64, table_m: F32) -> F32:
    """The table, filled with the ranges of drives one after another, brought into an order (n,)."""
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    before = 0
    for log in drives:
        for first in range(0, log.n_scans, _ROWS_AT_ONCE):
            part = copied_rows(log.ranges_m, slice(first, first + _ROWS_AT_ONCE))
            start = before + first
            table_m[place[start : start + part.shape[0]]] = _widened(part, table_m.shape[1])
            give_back(table_m)
        before += log.n_scans
    return table_m


def _after_one_another(numbers: Sequence[I32], sizes: Sequence[int]) -> list[I32]:
    """Numbers of several tables as numbers of the table that has them one after another."""
    before = np.concatenate([[0], np.cumsum(sizes)])
    return [(part + first).astype(np.int32) for part, first in zip(numbers, before, strict=False)]


def _widened(rows: NDArray[Any], n_beams: int) -> NDArray[Any]:
    """(n, n_beams) the same rows, NaN where a beam is missing."""
    result = np.full((rows.shape[0], n_beams), np.nan, dtype=rows.dtype)
    result[:, : rows.shape[1]] = rows
    return result


def end_points(log: ScanLog, poses: F64, chosen: B1) -> F64:
    """(n, 2) end points, in the map frame, of the chosen beams, scan by scan.

    Parameters
    ----------
    log : ScanLog
    poses : (n_scans, 3) float64
        map_from_robot.
    chosen : (n_scans, n_beams) bool
        Beams that have an end point.
    """
    scan, beam = np.nonzero(chosen)
    geometry = log.geometry_index[scan]
    bearing = log.bearings_rad[geometry, beam]
    ranges = np.asarray(log.ranges_m[scan, beam], dtype=np.float64)[:, None]
    in_sensor = ranges * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return transform_points(poses[scan], transform_points(log.sensor_poses[geometry], in_sensor))
