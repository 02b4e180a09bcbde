"""The columns of a recording that matching needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F32, F64, I32, I64
from dynmap_cli.domain.mapped import copied_rows
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.domain.sweep_motion import sweep_times_s


@dataclass(frozen=True, slots=True)
class Sweeps:
    """The columns of a recording that matching needs, in the order in which the sweeps were made.

    Ranges and weights stay where they are, which may be in files, and are read for some sweeps at a time.

    Attributes
    ----------
    table_m : (n, n_beams) float32
        Ranges in the order of the log, also of other sweeps.
    weights : (n, n_beams) float32 or None
        e of each beam, likewise; None = not known yet.
    rows : (n_scans,) int64
        Where each sweep is in them.
    geometry_index : (n_scans,) int32
    odometry : (n_scans, 3) float64
    times_s : (n_scans,) float64
        Ascending.
    drive_index : (n_scans,) int32
        Ascending.
    folder : Path or None
        Where is put what is made of them and takes much memory; None = where temporary files are put.
    """

    table_m: F32
    weights: F32 | None
    rows: I64
    geometry_index: I32
    odometry: F64
    times_s: F64
    drive_index: I32
    folder: Path | None = None

    @property
    def n_scans(self) -> int:
        """Number of sweeps."""
        return int(self.rows.size)

    @property
    def n_beams(self) -> int:
        """Beams of the widest geometry."""
        return int(self.table_m.shape[1])

    def read(self, scans: slice | I64) -> tuple[F32, F32]:
        """Ranges of some sweeps, and their weights (k, n_beams): NaN = not known yet, 0 where called dynamic.

        Beams that are called dynamic weigh nothing: a cell of the local map is one that was hit, however little it
        was, so that the trails of a crowd would attract scans.
        """
        rows = self.rows[scans]
        ranges_m: F32 = copied_rows(self.table_m, rows)
        if self.weights is None:
            return ranges_m, np.full_like(ranges_m, np.nan)
        weights: F32 = copied_rows(self.weights, rows)
        weights[weights < 0.5] = 0.0
        return ranges_m, weights

    def part(self, first: int, last: int) -> Sweeps:
        """The sweeps first..last - 1 only."""
        return self.chosen(slice(first, last))

    def chosen(self, scans: slice | I64) -> Sweeps:
        """Some sweeps only."""
        return Sweeps(
            self.table_m,
            self.weights,
            self.rows[scans],
            self.geometry_index[scans],
            self.odometry[scans],
            self.times_s[scans],
            self.drive_index[scans],
            self.folder,
        )


def sweeps_of(log: ScanLog, weights: F32 | None, folder: Path | None = None) -> Sweeps:
    """Columns in the order in which the sweeps were made; *weights* are in the order of the log."""
    order = np.argsort(log.arrival_index, kind="stable").astype(np.int64)
    return Sweeps(
        table_m=log.ranges_m,
        weights=weights,
        rows=order,
        geometry_index=np.array(log.geometry_index[order]),
        odometry=np.array(log.odometry[order]),
        times_s=times_of(log),
        drive_index=np.array(log.drive_index[order]),
        folder=folder,
    )


def times_of(log: ScanLog) -> F64:
    """(n_scans,) ascending seconds since the first scan, in the order in which the sweeps were made.

    Without the jitter of stamps; see `sweep_times_s`.
    """
    order = np.argsort(log.arrival_index, kind="stable")
    return np.asarray(np.maximum.accumulate(sweep_times_s(log)[order]))
