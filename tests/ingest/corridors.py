"""A drive along a bare corridor among people who walk along it, as columns of sweeps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynmap_cli.domain.poses import compose
from dynmap_cli.ingest.choices.frames import Mounting
from dynmap_cli.ingest.choices.merging import Columns
from dynmap_cli.ingest.choices.odometry_axes import mend_heading
from dynmap_cli.ingest.choices.odometry_sources import Odometry
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.raw.recording import RawRecording
from dynmap_cli.ingest.seen_motion.turns import Headings, turns_of
from tests.ingest.rooms import seen_from

_RADIUS_M, _MOUNTING = 0.22, np.array([0.1, 0.0, 0.0])
_SHAPE = ScanShape(-3.1, 6.2 / 360, 361, 0.1, 20.0)


@dataclass(frozen=True, slots=True)
class Corridor:
    """Along x from end to end; the robot drives along its middle, headed by yaw_rad, swaying a little."""

    length_m: float = 120.0
    width_m: float = 3.0
    speed_mps: float = 0.4
    yaw_rad: float = 0.0
    people_per_m: float = 0.0
    walk_mps: float = 1.3
    noise_m: float = 0.01
    seed: int = 1
    times_s: np.ndarray = field(default_factory=lambda: 0.1 * np.arange(300))

    @property
    def poses(self) -> np.ndarray:
        """(n, 3)."""
        x = -6.0 + self.speed_mps * self.times_s
        return np.column_stack([x, 0.0 * x, self.yaw_rad + 0.05 * np.sin(0.3 * self.times_s)])

    def sweeps(self) -> np.ndarray:
        """Ranges (n, n_beams)."""
        rng = np.random.default_rng(self.seed)
        x, y = self.length_m / 2.0, self.width_m / 2.0
        walls = np.array([(-x, -y, x, -y), (-x, y, x, y), (-x, -y, -x, y), (x, -y, x, y)])
        at = compose(self.poses, _MOUNTING)
        angles = at[:, 2:] + _SHAPE.bearings_rad
        ranges_m = seen_from(at[:, :2], angles, walls)
        for _ in range(round(self.people_per_m * self.length_m)):
            across = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, y - 0.3)
            along = rng.uniform(-x, x) + self.walk_mps * self.times_s
            ranges_m = np.minimum(ranges_m, _to_circle(along - at[:, 0], across - at[:, 1], angles))
        ranges_m += rng.normal(0.0, self.noise_m, ranges_m.shape)
        return np.where(ranges_m < _SHAPE.range_max_m, ranges_m, np.inf).astype(np.float32)


def _to_circle(x: np.ndarray, y: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Distances (n, n_beams) to circles at x, y (n,) from the laser, inf where a beam misses."""
    ahead = x[:, None] * np.cos(angles) + y[:, None] * np.sin(angles)
    beside = y[:, None] * np.cos(angles) - x[:, None] * np.sin(angles)
    reach = np.sqrt(np.maximum(_RADIUS_M**2 - beside**2, 0.0))
    return np.where((np.abs(beside) < _RADIUS_M) & (ahead > _RADIUS_M), ahead - reach, np.inf)


def mended(poses: np.ndarray, ranges_m: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Poses (n, 3) as they are mended by the sweeps (n, n_beams), and what is said."""
    laser = RawLaser("/scan")
    stamps_ns = 10**8 * np.arange(poses.shape[0])
    for stamp_ns, row in zip(stamps_ns.tolist(), ranges_m, strict=True):
        laser.add(stamp_ns, stamp_ns, row, _SHAPE)
    zeros = np.zeros(poses.shape[0], dtype=np.int32)
    columns = Columns(
        stamps_ns, ranges_m, zeros, zeros, zeros, [(0, _SHAPE)], np.zeros(1), np.arange(zeros.size)
    )
    recording = RawRecording("made", "none")
    odometry = mend_heading(
        Odometry("/odom", "", poses, 0.1, 1.0, 10.0),
        columns,
        turns_of(laser, Headings(stamps_ns, [poses])),
        Mounting(_MOUNTING, False, True, False),
        recording,
    )
    return odometry.poses, recording.warnings
