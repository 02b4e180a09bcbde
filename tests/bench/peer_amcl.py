"""Localize a recording with AMCL's own code: `python -m tests.bench.peer_amcl OUT/scans MAP.yaml X Y YAW OUT.tum`.

It updates every 0.1 m or 0.1 rad with 60 beams and 500 to 3000 particles, as dynmap does by default; scans between
updates follow the odometry.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import amcl
import numpy as np

from dynmap_cli.domain.grid import FREE, OCCUPIED
from dynmap_cli.domain.poses import Trajectory, between, compose
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import write_tum

UPDATE_M, UPDATE_RAD, START_SIGMA_M, START_SIGMA_RAD = 0.1, 0.1, 0.25, 0.15


def make_filter(map_yaml: Path, start: list[float], sensor: list[float]) -> amcl.AMCL:
    """AMCL with its usual parameters, at a start pose."""
    grid, _ = read_map(map_yaml)
    motion = amcl.MotionParameters(alpha1=0.1, alpha2=0.1, alpha3=0.1, alpha4=0.1, alpha5=0.1)
    laser = amcl.LaserParameters(
        z_hit=0.5,
        z_short=0.05,
        z_max=0.05,
        z_rand=0.5,
        sigma_hit=0.2,
        lambda_short=0.1,
        chi_outlier=0.05,
        max_beams=60,
    )
    localizer = amcl.AMCL(
        min_particles=500,
        max_particles=3000,
        alpha_slow=0.001,
        alpha_fast=0.1,
        motion_params=motion,
        laser_params=laser,
        robot_model_type="differential",
    )
    values = np.where(grid.cells == OCCUPIED, 100, np.where(grid.cells == FREE, 0, -1))
    frame = grid.frame
    localizer.set_map(
        amcl.create_occupancy_grid_from_list(
            values.tolist(), frame.resolution_m, frame.origin_x_m, frame.origin_y_m
        )
    )
    spread = amcl.Matrix3D()
    for axis, sigma in enumerate((START_SIGMA_M, START_SIGMA_M, START_SIGMA_RAD)):
        spread.set(axis, axis, sigma**2)
    localizer.set_laser_pose(amcl.Vector3D(*sensor))
    localizer.set_initial_pose(amcl.Vector3D(*start), spread)
    return localizer


def main(scans: Path, map_yaml: Path, start: list[float], out: Path) -> None:
    """Read the columns of a localization, write one pose per scan."""
    log = read_scan_log(scans)
    odometry = np.asarray(log.odometry)
    bearings = log.bearings_rad[0]
    high = float(log.range_limits_m[0, 1])
    localizer = make_filter(map_yaml, start, log.sensor_poses[0].tolist())
    poses = np.empty((log.n_scans, 3))
    last, at_last = 0, np.array(start)
    for scan in range(log.n_scans):
        moved = between(odometry[last], odometry[scan])
        if scan == 0 or math.hypot(moved[0], moved[1]) >= UPDATE_M or abs(moved[2]) >= UPDATE_RAD:
            ranges = np.asarray(log.ranges_m[scan], dtype=np.float64)
            used = np.isfinite(ranges)
            beams = amcl.create_laser_scan_from_list(np.column_stack([ranges, bearings])[used].tolist(), high)
            localizer.update(beams, amcl.Vector3D(*odometry[scan].tolist()))
            mean = localizer.get_pose_mean()
            last, at_last, moved = scan, np.array([mean.x, mean.y, mean.theta]), np.zeros(3)
        poses[scan] = compose(at_last, moved)
    write_tum(out, Trajectory(log.stamps_ns, poses))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), [float(word) for word in sys.argv[3:6]], Path(sys.argv[6]))
