"""scans/: the columns of a `ScanLog` as .npy files, opened memory-mapped."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np

from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError

_COLUMNS = tuple(field.name for field in fields(ScanLog) if field.name != "recordings")
SCAN_FILES = (*(f"scans/{name}.npy" for name in _COLUMNS), "scans/recordings.json")


def write_scan_log(folder: Path, log: ScanLog) -> None:
    """Write each column to `<folder>/<name>.npy` and the recording names to recordings.json."""
    for name in _COLUMNS:
        np.save(folder / f"{name}.npy", getattr(log, name))
    (folder / "recordings.json").write_text(json.dumps(list(log.recordings)) + "\n", encoding="utf-8")


def read_scan_log(folder: Path) -> ScanLog:
    """Open the columns of a finished ingest; the ranges stay on disk until they are used."""
    try:
        columns = {
            name: np.load(
                folder / f"{name}.npy", mmap_mode="r" if name == "ranges_m" else None, allow_pickle=False
            )
            for name in _COLUMNS
        }
        recordings = tuple(json.loads((folder / "recordings.json").read_text(encoding="utf-8")))
        return ScanLog(recordings=recordings, **columns)
    except (OSError, EOFError, ValueError, TypeError) as err:
        msg = f"{folder}: not a readable scan folder ({err}). Run `dynmap ingest` again with --force."
        raise ArtifactError(msg) from err
