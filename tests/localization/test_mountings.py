"""A later recording of a robot whose lasers are mounted otherwise than stated."""

from dataclasses import replace

import numpy as np

from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.files import registered
from dynmap_cli.files.registered import with_mountings_of, write_mountings

PER_LASER = ("bearings_rad", "beam_interval_s", "first_beam_s", "range_limits_m")


def one_scan():
    """A log of one scan of one laser."""
    return single_laser_log(
        np.zeros(1, dtype=np.int64), np.ones((1, 5), np.float32), np.linspace(-1, 1, 5), np.zeros((1, 3))
    )


def with_lasers(log, *poses):
    """The same log with the one laser that it has in several places."""
    copies = {name: np.repeat(getattr(log, name), len(poses), axis=0) for name in PER_LASER}
    return replace(log, sensor_poses=np.array(poses), **copies)


def test_lasers_stated_in_the_same_place_are_where_the_map_found_them_and_others_stay(tmp_path, monkeypatch):
    log = one_scan()
    first, second, third = [0.2, 0.0, 0.0], [-0.2, 0.0, 3.1], [0.0, 0.3, 1.0]
    mapped, later = (with_lasers(log, *poses) for poses in ((first, second), (second, third, first)))
    monkeypatch.setattr(registered, "read_scan_log", lambda _: mapped)
    assert with_mountings_of(later, tmp_path, tmp_path) == (later, "")
    corrected = [-0.21, 0.01, 3.14]
    write_mountings(tmp_path, np.array([first, corrected]))
    found, told = with_mountings_of(later, tmp_path, tmp_path)
    assert told == "1 laser taken to be mounted as the map found it, not as stated"
    np.testing.assert_array_equal(found.sensor_poses, [corrected, third, first])


def test_without_the_scans_of_a_run_lasers_are_where_they_are_stated_to_be(tmp_path):
    log = with_lasers(one_scan(), [0.2, 0.0, 0.0], [-0.2, 0.0, 3.14])
    write_mountings(tmp_path, log.sensor_poses + 0.01)
    found, told = with_mountings_of(log, tmp_path / "taken-away", tmp_path)
    assert found is log
    assert "as stated" in told
