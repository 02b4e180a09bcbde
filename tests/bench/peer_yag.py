"""Map a recording with yag-slam: `python -m tests.bench.peer_yag RUN/scans OUT.tum`.

Key scans every 0.2 m or 10 degrees, as Karto does; scans between them follow the odometry from the last one.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from tiny_tf.tf import Transform
from yag_slam.graph_slam import GraphSlam
from yag_slam.helpers import default_config, default_config_loop
from yag_slam.models import LocalizedRangeScan
from yag_slam.scan_matching import Scan2DMatcherCpp

from dynmap_cli.domain.poses import Trajectory, between, compose, inverse
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import write_tum

KEY_M, KEY_RAD, RANGE_M = 0.2, math.radians(10.0), 20.0


def main(scans: Path, out: Path) -> None:
    """Read the columns of a run, write one pose per scan."""
    log = read_scan_log(scans)
    geometry = int(log.geometry_index[0])
    bearings, sensor = log.bearings_rad[geometry], log.sensor_poses[geometry]
    low, high = (float(limit) for limit in log.range_limits_m[geometry])
    lasers = compose(np.asarray(log.odometry), sensor)
    ranges = np.nan_to_num(np.asarray(log.ranges_m, dtype=np.float64), nan=high + 1.0, posinf=high + 1.0)
    slam = GraphSlam(Scan2DMatcherCpp(default_config), Scan2DMatcherCpp(default_config_loop, loop=True))
    step = float(bearings[1] - bearings[0])
    key_of, keys, last = np.empty(log.n_scans, dtype=int), [], None
    # In the order in which the sweeps were made: some recordings have wrong stamps.
    order = np.argsort(log.arrival_index, kind="stable")
    for scan in order.tolist():
        moved = np.full(3, np.inf) if last is None else between(lasers[last], lasers[scan])
        if math.hypot(moved[0], moved[1]) >= KEY_M or abs(moved[2]) >= KEY_RAD:
            x, y, yaw = lasers[scan].tolist()
            made = LocalizedRangeScan(
                ranges[scan].tolist(),
                float(bearings[0]),
                float(bearings[-1]),
                step,
                low,
                high,
                RANGE_M,
                x,
                y,
                yaw,
            )
            made.odom_pose = Transform.from_position_euler(x, y, 0, 0, 0, yaw)
            slam.process_scan(made)
            keys.append(made)
            last = scan
        key_of[scan] = len(keys) - 1
    found = [key.corrected_pose for key in keys]
    corrected = np.array([[pose.x, pose.y, pose.euler[-1]] for pose in found])
    firsts = order[np.searchsorted(key_of[order], np.arange(len(keys)))]
    poses = compose(corrected[key_of], between(lasers[firsts[key_of]], lasers))
    write_tum(out, Trajectory(log.stamps_ns, compose(poses, inverse(sensor))))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
