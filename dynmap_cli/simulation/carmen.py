"""CARMEN text: `ODOM`, and `FLASER` for one laser of a half circle, `ROBOTLASER<n>` for any other."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F32
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.errors import ConfigError
from dynmap_cli.simulation.run import SimulatedRun

NO_RETURN_M = 81.83
"""What SICK lasers report where nothing came back; FLASER lines say nothing of a longest range."""
_HEADER = """# CARMEN Logfile
# ODOM x y theta tv rv accel ipc_timestamp ipc_hostname logger_timestamp
# FLASER num_readings [range_readings] x y theta odom_x odom_y odom_theta ipc_timestamp ipc_hostname logger_timestamp
# ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode \
num_readings [range_readings] num_remissions [remission_values] laser_pose_x laser_pose_y laser_pose_theta \
robot_pose_x robot_pose_y robot_pose_theta laser_tv laser_rv forward_safety_dist side_safety_dist turn_axis \
ipc_timestamp ipc_hostname logger_timestamp
"""


def write_carmen(path: Path, run: SimulatedRun) -> None:
    """Write all sweeps and odometry readings in the order of their stamps.

    Raises
    ------
    ConfigError
        If there is no odometry, which every line of this format carries.
    """
    if run.odometry.stamps_ns.size == 0:
        msg = "CARMEN lines carry odometry and this scenario has none. Write .mcap or .bag instead."
        raise ConfigError(msg)
    lines = [*_odometry_lines(run), *_scan_lines(run)]
    lines.sort(key=lambda line: line[0])
    path.write_text(_HEADER + "".join(text for _, text in lines), encoding="ascii")


def _odometry_lines(run: SimulatedRun) -> list[tuple[int, str]]:
    """Stamp and text of each odometry reading."""
    series = run.odometry
    steps = between(series.poses[:-1], series.poses[1:])
    seconds = np.maximum(np.diff(series.stamps_ns) * 1e-9, 1e-6)
    speeds = np.concatenate([np.zeros((1, 3)), steps / seconds[:, None]]).tolist()
    rows = zip(series.stamps_ns.tolist(), series.poses.tolist(), speeds, strict=True)
    return [
        (stamp, f"ODOM {_numbers(pose)} {speed[0]:.6f} {speed[2]:.6f} 0 {_times(run, stamp)}\n")
        for stamp, pose, speed in rows
    ]


def _scan_lines(run: SimulatedRun) -> list[tuple[int, str]]:
    """Stamp and text of each sweep."""
    log, lasers = run.log, run.scenario.lasers
    robot_poses = log.odometry
    laser_poses = compose(robot_poses, log.sensor_poses[log.geometry_index])
    lines = []
    for row, stamp in enumerate(log.stamps_ns.tolist()):
        which = int(log.geometry_index[row])
        laser = lasers[which]
        ranges = f"{laser.beams} {_ranges(log.ranges_m[row, : laser.beams])}"
        poses = f"{_numbers(laser_poses[row].tolist())} {_numbers(robot_poses[row].tolist())}"
        if len(lasers) == 1 and laser.fov_deg == 180.0 and laser.beams in {181, 361} and not laser.clockwise:
            text = f"FLASER {ranges} {poses} {_times(run, stamp)}\n"
        else:
            bearings = log.bearings_rad[which]
            angles = f"{bearings[0]:.9f} {math.radians(laser.fov_deg):.9f} {bearings[1] - bearings[0]:.9f}"
            text = (
                f"ROBOTLASER{which + 1} 0 {angles} {laser.max_range_m:.6f} {laser.noise_m:.6f} 0 {ranges} 0 "
                f"{poses} 0 0 0 0 0 {_times(run, stamp)}\n"
            )
        lines.append((stamp, text))
    return lines


def _ranges(ranges_m: F32) -> str:
    """Ranges with three decimals; codes of the driver where nothing came back or a thing was too close."""
    values = np.where(np.isinf(ranges_m), NO_RETURN_M, np.nan_to_num(ranges_m, nan=0.0))
    return " ".join(f"{value:.3f}" for value in values.tolist())


def _numbers(values: list[float]) -> str:
    """Numbers with six decimals."""
    return " ".join(f"{value:.6f}" for value in values)


def _times(run: SimulatedRun, stamp_ns: int) -> str:
    """Time stamp, host, and time since the start of the recording."""
    since = (stamp_ns - int(run.odometry.stamps_ns[0])) // 1000
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9 // 1000:06d} simulated {since / 1e6:.6f}"
