"""The front end: scans registered one after another."""

from dataclasses import replace

import numpy as np

from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.kernels.matching import SIZE
from dynmap_cli.mapping.matched_range import matched_range_m
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.front_end import register
from dynmap_cli.scan_matching.matcher import FrontEndParams
from dynmap_cli.scan_matching.odometry import corrected_motion
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


YARD_M = np.array([37.0, 38.0])
"""Walls stand so far from the middle of an empty yard, along x and y."""


def yard_log(n_steps, slips_at, slip_rad):
    """A robot that drives a bend in the middle of the yard, and once counts a turn that it did not make."""
    bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    poses, odometry = np.zeros((n_steps + 1, 3)), np.zeros((n_steps + 1, 3))
    for k in range(n_steps):
        step = np.array([0.1, 0.0, np.radians(1.0)])
        poses[k + 1] = compose(poses[k], step)
        step[2] += slip_rad if k + 1 == slips_at else 0.0
        odometry[k + 1] = compose(odometry[k], step)
    directions = poses[:, 2:3] + bearings
    ends = np.stack([np.cos(directions), np.sin(directions)], axis=-1)
    to_walls = (YARD_M * np.sign(ends) - poses[:, None, :2]) / np.where(ends == 0.0, 1e-12, ends)
    ranges = to_walls.min(axis=-1).astype(np.float32)
    stamps_ns = (np.arange(n_steps + 1) * STEP_S * 1e9).astype(np.int64)
    return single_laser_log(stamps_ns, ranges, bearings, odometry, range_limits_m=(0.05, 80.0)), poses


def test_a_wheel_that_slips_in_the_open_is_not_believed_where_walls_stand_far():
    """Nothing stands within the 30 m that are counted in the map by default."""
    log, poses = yard_log(60, 45, np.radians(7.0))
    sweeps = sweeps_of(log, None)
    motion = corrected_motion(sweeps.odometry, sweeps.times_s, Calibration())
    errors_deg = [
        np.degrees(
            np.abs(register(sweeps, rays, motion, Calibration(), FrontEndParams()).poses - poses)[-1, 2]
        )
        for rays in (rays_of(log, 30.0), rays_of(log, matched_range_m(log, 30.0)))
    ]
    assert errors_deg[0] > 5.0
    assert errors_deg[1] < 0.2


def test_returns_are_matched_farther_only_where_many_scans_see_nothing_near():
    """And never so far that a scan could meet itself around the torus of the local map."""
    log, _ = yard_log(200, 1, 0.0)
    params = FrontEndParams()
    assert matched_range_m(log, 30.0) == params.farthest_m
    assert 2 * params.farthest_m + params.reach_m <= SIZE * params.cell_m
    ranges_m = np.array(log.ranges_m)
    ranges_m[2:, :100] = 5.0  # two scans in two hundred may see less
    assert matched_range_m(replace(log, ranges_m=ranges_m), 30.0) == 30.0
    assert matched_range_m(replace(log, ranges_m=np.full_like(ranges_m, np.inf)), 30.0) == 30.0
    assert matched_range_m(log, 50.0) == 50.0
