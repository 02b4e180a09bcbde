"""Drives: joined in time order, taken apart again, and checked when they are read."""

import numpy as np
import pytest

from dynmap_cli.domain.scans import join_drives, single_laser_log
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.scan_log import read_scan_log, write_scan_log


def drive(first_s, n_scans, n_beams, name):
    rng = np.random.default_rng(n_beams)
    stamps_ns = ((first_s + np.arange(n_scans)) * 1e9).astype(np.int64)
    return single_laser_log(
        stamps_ns,
        rng.uniform(1, 5, (n_scans, n_beams)).astype(np.float32),
        np.linspace(-1, 1, n_beams),
        rng.normal(size=(n_scans, 3)),
        recording=name,
    )


def test_one_drive_is_itself():
    log = drive(0, 4, 7, "a")
    assert join_drives([log]) is log
    assert log.n_drives == 1


def test_joined_drives_keep_their_sweeps_and_geometries():
    a, b = drive(0, 4, 7, "a"), drive(10, 3, 5, "b")
    joined = join_drives([a, b])
    assert joined.recordings == ("a", "b")
    assert joined.n_drives == 2
    for number, part in enumerate((a, b)):
        own = joined.select(joined.drive_index == number)
        np.testing.assert_array_equal(own.stamps_ns, part.stamps_ns)
        np.testing.assert_array_equal(own.odometry, part.odometry)
        np.testing.assert_array_equal(own.ranges_m[:, : part.n_beams], part.ranges_m)
        assert np.isnan(own.ranges_m[:, part.n_beams :]).all()
        assert (own.geometry_index == number).all()
        np.testing.assert_array_equal(own.bearings_rad[number, : part.n_beams], part.bearings_rad[0])
        assert joined.recordings_of(number) == part.recordings


def test_sweeps_are_in_time_order_also_where_drives_overlap_a_little():
    joined = join_drives([drive(0, 4, 7, "a"), drive(2.5, 3, 7, "b")])
    assert (np.diff(joined.stamps_ns) >= 0).all()
    assert joined.drive_index.tolist() == [0, 0, 0, 1, 0, 1, 1]
    # In the order in which they were made, the drives come one after another.
    assert joined.drive_index[np.argsort(joined.arrival_index)].tolist() == [0, 0, 0, 0, 1, 1, 1]


def test_ranges_are_put_where_they_are_wanted():
    drives = [drive(0, 4, 7, "a"), drive(2.5, 3, 5, "b")]
    table = np.zeros((7, 7), dtype=np.float32)
    joined = join_drives(drives, table)
    assert joined.ranges_m is table
    np.testing.assert_array_equal(table, join_drives(drives).ranges_m)


@pytest.mark.parametrize("numbers", [[1, 1], [0, 2], [1, 0]])
def test_drives_that_are_not_numbered_in_order_are_refused(numbers, tmp_path):
    write_scan_log(tmp_path, join_drives([drive(0, 4, 7, "a"), drive(10, 3, 5, "b")]))
    np.testing.assert_array_equal(read_scan_log(tmp_path).drive_of_recording, [0, 1])
    np.save(tmp_path / "drive_of_recording.npy", np.array(numbers, dtype=np.int32))
    with pytest.raises(ArtifactError, match="does not number the drives"):
        read_scan_log(tmp_path)
