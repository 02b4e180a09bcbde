"""The front end: scans registered one after another."""

import numpy as np

from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.mapping.front_end import register
from dynmap_cli.mapping.odometry import corrected_motion
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.matcher import FrontEndParams
from dynmap_cli.scan_matching.sweeps import sweeps_of
from tests.mapping.test_local_maps import cast

STEP_S, BEAMS = 0.1, 180


def test_a_sweep_that_takes_time_is_straightened_by_the_motion_after_its_stamp():
    """A robot that stands, turns, stands: the scans at both ends of the turn are as good as the others."""
    turns = np.concatenate([np.zeros(10), np.full(12, np.radians(6.0)), np.zeros(10)])
    poses = np.zeros((turns.size + 1, 3))
    for k, turn in enumerate(turns):
        poses[k + 1] = compose(poses[k], np.array([0.0, 0.0, turn]))
    bearings = np.linspace(-np.pi * 0.7, np.pi * 0.7, BEAMS)
    interval_s = 0.8 * STEP_S / BEAMS
    ranges = np.empty((poses.shape[0], BEAMS), dtype=np.float32)
    for k, pose in enumerate(poses):
        rate = turns[min(k, turns.size - 1)] / STEP_S
        for beam in range(BEAMS):
            there = compose(pose, np.array([0.0, 0.0, beam * interval_s * rate]))
            ranges[k, beam] = cast(there, bearings[beam : beam + 1])[0]
    stamps_ns = (np.arange(poses.shape[0]) * STEP_S * 1e9).astype(np.int64)
    log = single_laser_log(stamps_ns, ranges, bearings, poses, beam_interval_s=interval_s)
    sweeps = sweeps_of(log, None)
    calibration = Calibration(sweep="first to last")
    motion = corrected_motion(sweeps.odometry, sweeps.times_s, calibration)
    found = register(sweeps, rays_of(log, 30.0), motion, calibration, FrontEndParams())
    errors = between(between(poses[:1], poses), found.poses)
    assert np.hypot(errors[:, 0], errors[:, 1]).max() < 0.005
    assert np.degrees(np.abs(errors[:, 2])).max() < 0.2
