"""Two lasers whose stated mountings contradict one another, and how far the matches of single scans are believed."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose, inverse, wrap_angle
from dynmap_cli.mapping.rounds import build_filter_map
from dynmap_cli.mapping.settings import MapSettings
from dynmap_cli.mapping.site import Site
from dynmap_cli.mapping.summary import summarize
from dynmap_cli.scan_matching.front_end import Registered
from dynmap_cli.scan_matching.several_lasers import agreement
from dynmap_cli.simulation import parse_scenario, simulate
from tests.mapping.test_site import FIRST, WALLS

ERROR = np.array([0.015, -0.013, np.radians(0.5)])
LASER = {"noise_m": 0.015, "rate_hz": 5, "max_range_m": 12, "fov_deg": 240}


@pytest.fixture(scope="module")
def run():
    """A drive with one laser that looks ahead and one that looks back."""
    return simulate(
        parse_scenario(
            {
                "seed": 1,
                "world": {"walls": WALLS},
                "robot": {"path": FIRST, "speed_mps": 0.6},
                "lasers": [
                    {**LASER, "name": "front", "pose": [0.4, 0, 0]},
                    {**LASER, "name": "back", "pose": [-0.4, 0, 180]},
                ],
                "odometry": {"rotation_scale": 0.98, "bias_degpm": 0.4},
            }
        )
    )


@pytest.fixture(scope="module")
def wrongly_stated(run):
    sensor_poses = run.log.sensor_poses.copy()
    sensor_poses[1] = compose(inverse(ERROR), sensor_poses[1])
    return replace(run.log, sensor_poses=sensor_poses)


def path_m(poses):
    return float(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).sum())


def test_a_laser_that_is_not_where_it_is_said_to_be_is_found(run, wrongly_stated):
    site = Site(wrongly_stated, MapSettings(max_rounds=1))
    poses = site.poses(None, "")
    (drive,) = site.drives
    assert len(drive.mountings) == 1
    true, found = (between(each[:1], each[1:])[0] for each in (run.log.sensor_poses, site.log.sensor_poses))
    assert np.hypot(*(found - true)[:2]) < 0.005
    assert abs(wrap_angle(found[2:] - true[2:])[0]) < np.radians(0.05)
    np.testing.assert_array_equal(site.log.sensor_poses, drive.log.sensor_poses)
    assert path_m(poses) < 1.01 * path_m(run.true_poses)


def test_lasers_that_are_where_they_are_said_to_be_stay_there(run):
    site = Site(run.log, MapSettings(max_rounds=1))
    site.poses(None, "")
    (drive,) = site.drives
    assert drive.mountings == ()
    assert drive.believed_share == 1.0
    np.testing.assert_array_equal(site.log.sensor_poses, run.log.sensor_poses)


@pytest.mark.parametrize("is_right", [True, False])
def test_the_summary_says_so(run, wrongly_stated, is_right):
    log = run.log if is_right else wrongly_stated
    settings = MapSettings(max_rounds=1)
    result = build_filter_map(log, settings, threads=1)
    lines = [line for line in summarize(log, result, 30.0)["lines"] if line.startswith("laser at")]
    assert len(lines) == (0 if is_right else 1)
    assert np.array_equal(result.sensor_poses, log.sensor_poses) == is_right
    if lines:
        assert "off what is stated, relative to the laser at x" in lines[0]


def matched(excess_sigmas, offset):
    """A robot that stands, as seen by two lasers in turn, with poses as uncertain as stated times a factor."""
    rng, n_scans = np.random.default_rng(0), 4000
    sigma = np.array([0.004, 0.003, 0.001])
    poses = rng.standard_normal((n_scans, 3)) * sigma * excess_sigmas
    poses[1::2] += offset
    no = np.zeros(n_scans, dtype=bool)
    information = np.broadcast_to(np.diag(sigma**-2), (n_scans, 3, 3))
    found = Registered(poses, np.ones(n_scans), information, np.zeros((n_scans, 3)), no, no, no)
    return agreement(found, 0.05 * np.arange(n_scans), np.arange(n_scans) % 2, 0)


@pytest.mark.parametrize("factor", [1.0, 3.0])
def test_the_excess_is_the_variance_of_unit_weight(factor):
    found = matched(factor, 0.0)
    assert found.excess == pytest.approx(factor**2, rel=0.1)
    assert found.believed_share == (1.0 if factor == 1.0 else 1.0 / found.excess)
    assert not found.is_off.any()


def test_an_offset_is_measured_with_its_error():
    offset = np.array([0.012, 0.0, -0.004])
    found = matched(1.0, offset)
    assert (np.abs(found.offsets[1] - offset) < 4.0 * found.errors[1] + 1e-4).all()
    assert found.is_off.tolist() == [False, True]
