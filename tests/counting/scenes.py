"""A minute in front of a wall, with something before it now and then."""

import numpy as np

from dynmap_cli.domain.scans import single_laser_log

N_SCANS, RATE_HZ, WALL_M, THING_M = 600, 10, 3.0, 2.0


def scene(is_there, thing_m=THING_M, pause_s=0.0):
    """*is_there* (n_scans, n_beams) says which beams meet a thing; the robot is off for a while in the middle."""
    bearings = np.radians(np.linspace(-4.0, 4.0, 9))
    ranges = np.where(is_there, thing_m, WALL_M) / np.cos(bearings)
    times_s = np.arange(N_SCANS) / RATE_HZ + pause_s * (np.arange(N_SCANS) >= N_SCANS // 2)
    stamps_ns = np.round(times_s * 1e9).astype(np.int64)
    return single_laser_log(stamps_ns, ranges.astype(np.float32), bearings, np.zeros((N_SCANS, 3)))


def standing(first_s, last_s, beams=slice(None)):
    """Which beams, (n_scans, 9), meet who stands there from one time to another."""
    times_s = np.arange(N_SCANS) / RATE_HZ
    is_there = np.zeros((N_SCANS, 9), dtype=bool)
    is_there[(times_s >= first_s) & (times_s < last_s), beams] = True
    return is_there
