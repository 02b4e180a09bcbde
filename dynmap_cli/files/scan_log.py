"""scans/: the columns of a `ScanLog` as .npy files, opened memory-mapped."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.documents import parse_json, read_text
from dynmap_cli.files.npy import Array, Column, read_npy, write_npy

_COLUMNS = {
    "stamps_ns": Column("<i8", (None,)),
    "ranges_m": Column("<f4", (None, None)),
    "odometry": Column("<f8", (None, 3)),
    "geometry_index": Column("<i4", (None,)),
    "bearings_rad": Column("<f8", (None, None)),
    "sensor_poses": Column("<f8", (None, 3)),
    "range_limits_m": Column("<f8", (None, 2)),
    "beam_interval_s": Column("<f8", (None,)),
    "recording_index": Column("<i4", (None,)),
    "arrival_index": Column("<i4", (None,)),
    "drive_of_recording": Column("<i4", (None,)),
}
SCAN_FILES = (*(f"scans/{name}.npy" for name in _COLUMNS), "scans/recordings.json")


def write_scan_log(folder: Path, log: ScanLog) -> None:
    """Write each column to `<folder>/<name>.npy` and the recording names to recordings.json."""
    for name, column in _COLUMNS.items():
        write_npy(folder / f"{name}.npy", np.ascontiguousarray(getattr(log, name), dtype=column.dtype))
    (folder / "recordings.json").write_text(json.dumps(list(log.recordings)) + "\n", encoding="utf-8")


def read_scan_log(folder: Path) -> ScanLog:
    """Open the columns of a finished ingest; the ranges stay on disk until they are used.

    Raises
    ------
    ArtifactError
        If a file is missing, damaged, or does not fit the others.
    """
    with refusing_damage(
        f"{folder}: not a readable scan folder", "Run `dynmap ingest` again with --force.", ArtifactError
    ):
        columns = {
            name: read_npy(folder / f"{name}.npy", column, in_memory=name != "ranges_m")
            for name, column in _COLUMNS.items()
        }
        recordings = parse_json(read_text(folder / "recordings.json"))
        _check(columns, recordings)
        return ScanLog(recordings=tuple(recordings), **columns)


def _check(columns: dict[str, Array], recordings: object) -> None:
    """Refuse values that no recording gives; shapes and order are checked by `ScanLog`."""
    if not isinstance(recordings, list) or not all(isinstance(name, str) for name in recordings):
        msg = "recordings.json is not a list of names"
        raise ValueError(msg)
    index, arrival = columns["recording_index"], columns["arrival_index"]
    if index.size and not 0 <= index.min() <= index.max() < len(recordings):
        msg = f"recording_index points outside the {len(recordings)} recordings"
        raise ValueError(msg)
    if not np.array_equal(np.sort(arrival), np.arange(arrival.size)):
        msg = "arrival_index does not rank the scans"
        raise ValueError(msg)
    drives = columns["drive_of_recording"]
    if drives.size == 0 or drives[0] != 0 or not np.isin(np.diff(drives), (0, 1)).all():
        msg = "drive_of_recording does not number the drives"
        raise ValueError(msg)
    for name, is_wrong in (
        ("sensor_poses", ~np.isfinite(columns["sensor_poses"])),
        ("beam_interval_s", ~np.isfinite(columns["beam_interval_s"])),
        ("bearings_rad", np.isinf(columns["bearings_rad"])),
        ("range_limits_m", np.isnan(columns["range_limits_m"])),
    ):
        if is_wrong.any():
            msg = f"{name} has values that are no numbers of that kind"
            raise ValueError(msg)
