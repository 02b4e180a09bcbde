"""Where observation sequences are cut."""

from dataclasses import replace

import numpy as np

from dynmap_cli.clustering.sequences import SequenceParams, cut_sequences, distance_to
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.scans import single_laser_log

FRAME = GridFrame(0.05, 10.0, 0.0, 20, 40)


def drive(x_m, step_s=0.2, recording=None):
    n = len(x_m)
    poses = np.column_stack([x_m, np.full(n, 0.5), np.zeros(n)])
    stamps = np.round(np.arange(n) * step_s * 1e9).astype(np.int64)
    log = single_laser_log(stamps, np.ones((n, 1), np.float32), np.zeros(1), poses)
    if recording is not None:
        log = replace(
            log,
            recording_index=np.asarray(recording, np.int32),
            recordings=("a", "b"),
            drive_of_recording=np.zeros(2, np.int32),
        )
    return log, poses


def lengths(x_m, params=None, **kwargs):
    log, poses = drive(x_m, **kwargs)
    return [len(part) for part in cut_sequences(log, poses, FRAME, params or SequenceParams())]


def test_distance_is_zero_inside_and_euclidean_outside():
    points = np.array([[11.0, 0.5], [12.0, 0.5], [9.0, 0.5], [13.0, 2.0], [np.nan, 0.0]])
    np.testing.assert_allclose(distance_to(FRAME, points), [0.0, 0.0, 1.0, np.hypot(1, 1), np.nan])


def test_near_counts_as_in_since_the_rectangle_of_a_door_is_never_entered():
    beside = np.r_[np.zeros(10), np.full(20, 13.5), np.zeros(10)]
    assert lengths(beside) == [20]
    assert lengths(beside, SequenceParams(near_m=1.0)) == []


def test_leaving_ends_a_sequence_and_a_moment_outside_does_not():
    assert lengths(np.r_[np.full(20, 11.0), np.full(15, 30.0), np.full(12, 11.0)]) == [20, 12]
    assert lengths(np.r_[np.full(20, 11.0), np.full(8, 30.0), np.full(12, 11.0)]) == [32]


def test_a_long_stay_is_cut_every_thirty_seconds():
    assert lengths(np.full(400, 11.0)) == [150, 150, 100]


def test_sequences_of_few_scans_are_left_out():
    assert lengths(np.r_[np.full(7, 11.0), np.full(20, 30.0), np.full(8, 11.0)]) == [8]


def test_a_slow_laser_is_no_reason_to_cut():
    assert lengths(np.full(12, 11.0), step_s=2.4) == [12]


def test_a_sequence_ends_with_its_recording():
    assert lengths(np.full(40, 11.0), recording=[0] * 15 + [1] * 25) == [15, 25]


def test_poses_that_are_nowhere_are_in_no_sequence():
    assert lengths(np.full(20, np.nan)) == []
