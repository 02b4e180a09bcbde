"""Odometry that its scans do not bear out: late, wrong in scale, frozen, slipping, or none at all."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import between, compose, wrap_angle
from dynmap_cli.localization.odometry import sound_odometry, with_sound_odometry
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.simulation.run import simulate
from tests.localization.worlds import corridor, office, pose_errors

SETTINGS = LocalizationSettings()
AHEAD = 10
"""Scans over which steps are compared, two seconds."""


@pytest.fixture(scope="module")
def run():
    return simulate(office(seed=3))


def step_errors(poses, true):
    """Metres and degrees by which the steps over two seconds are off, where there are any."""
    off = between(poses[:-AHEAD], poses[AHEAD:]) - between(true[:-AHEAD], true[AHEAD:])
    off = off[np.isfinite(off).all(axis=1)]
    return np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(wrap_angle(off[:, 2])))


def found_without_a_start(run, log):
    pool = make_map_pool(run.true_map, (), SETTINGS)
    return localize_log(with_sound_odometry(log, SETTINGS)[0], pool, SETTINGS, seed=0)


def stuck(log, first, last):
    """The same recording with odometry that does not count from one scan to another."""
    odometry = log.odometry.copy()
    odometry[first:last] = odometry[first]
    odometry[last:] = compose(odometry[first], between(log.odometry[last], log.odometry[last:]))
    return replace(log, odometry=odometry)


def test_sound_odometry_stays_as_it_is(run):
    found = sound_odometry(run.log, SETTINGS)
    assert found.has_wheels and not found.faults
    away_m, away_deg = step_errors(found.poses, run.log.odometry)
    assert away_m.max() < 0.02
    assert away_deg.max() < 2.0


def test_odometry_that_is_late_and_counts_wrong_is_put_right():
    wheels = {"lag_s": 0.2, "translation_scale": 0.95, "rotation_scale": 0.95}
    run = simulate(office(seed=3, odometry=wheels))
    found = sound_odometry(run.log, SETTINGS)
    before_m, before_deg = step_errors(run.log.odometry, run.true_poses)
    after_m, after_deg = step_errors(found.poses, run.true_poses)
    assert after_m.mean() < 0.35 * before_m.mean()
    assert after_deg.mean() < 0.35 * before_deg.mean()


def test_without_odometry_the_scans_link_one_another(run):
    log = replace(run.log, odometry=np.full_like(run.log.odometry, np.nan))
    found = sound_odometry(log, SETTINGS)
    assert not found.has_wheels
    assert np.isfinite(found.poses).all(axis=1).mean() > 0.95
    away_m, away_deg = step_errors(found.poses, run.true_poses)
    assert away_m.max() < 0.05
    assert away_deg.max() < 1.0


def test_odometry_that_never_moves_is_none(run):
    found = found_without_a_start(run, stuck(run.log, 0, run.log.n_scans - 1))
    away_m, away_deg = pose_errors(found.trajectory.poses, run.true_poses)
    assert away_m.max() < 0.2
    assert away_deg.max() < 5.0
    assert "lost" not in {row.verdict for row in found.health}


def test_odometry_that_freezes_on_the_way_is_led_by_the_scans(run):
    log = stuck(run.log, 100, 160)
    found = sound_odometry(log, SETTINGS)
    assert [fault.is_frozen for fault in found.faults] == [True]
    assert abs(found.faults[0].start_s - 20.0) < 1.5
    assert abs(found.faults[0].end_s - 32.0) < 1.5
    away_m, _ = step_errors(found.poses, run.true_poses)
    assert away_m.max() < 0.15
    _, words = with_sound_odometry(log, SETTINGS)
    assert words[0].startswith("simulated: the odometry stood still from t = ")


def test_a_wheel_that_slips_is_noticed(run):
    odometry = run.log.odometry.copy()
    odometry[120:] = compose(
        compose(odometry[120], np.array([0.0, 0.0, 0.6])), between(odometry[120], odometry[120:])
    )
    found = sound_odometry(replace(run.log, odometry=odometry), SETTINGS)
    assert [fault.is_frozen for fault in found.faults] == [False]
    _, away_deg = step_errors(found.poses, run.true_poses)
    assert away_deg.max() < 5.0


def test_a_robot_that_stands_in_a_stream_of_people_has_not_moved():
    path = [[2.0, 2.0], {"to": [2.6, 2.0], "wait_s": 60.0}, [8.0, 1.5]]
    stream = {"does": "stream", "path": [[0.5, 2.2], [13.5, 1.8]], "count": 25, "width_m": 3.0}
    run = simulate(office(seed=4, path=path, movers=[stream]))
    found = sound_odometry(run.log, SETTINGS)
    assert not found.faults
    stands = slice(20, 300)
    assert np.ptp(found.poses[stands, :2], axis=0).max() < 0.02


def test_along_a_bare_corridor_scans_do_not_tell_the_position():
    scenario = corridor(length_m=60.0, path=((22.0, 1.0), (50.0, 1.0)))
    log = simulate(scenario).log
    found = sound_odometry(replace(log, odometry=np.full_like(log.odometry, np.nan)), SETTINGS)
    assert np.isnan(found.poses[20:-80]).any(axis=1).mean() > 0.9


def test_each_drive_has_its_own_and_one_scan_is_no_drive(run):
    part = run.log.select(slice(0, 101))
    log = replace(
        part,
        recording_index=np.repeat([0, 1], [100, 1]).astype(np.int32),
        recordings=("first", "second"),
        drive_of_recording=np.array([0, 1], dtype=np.int32),
    )
    found, words = with_sound_odometry(log, SETTINGS)
    alone = sound_odometry(part.select(slice(0, 100)), SETTINGS)
    assert words == []
    assert found.odometry[:100].tobytes() == alone.poses.tobytes()
    assert found.odometry[100].tobytes() == log.odometry[100].tobytes()


def test_scans_far_more_often_than_needed_are_all_given_a_pose():
    lasers = [{"fov_deg": 180, "beams": 91, "max_range_m": 30, "noise_m": 0.02, "rate_hz": 40}]
    run = simulate(office(seed=3, lasers=lasers))
    log = replace(run.log, odometry=np.full_like(run.log.odometry, np.nan))
    found = sound_odometry(log, SETTINGS)
    assert np.isfinite(found.poses).all(axis=1).mean() > 0.95
    away_m, _ = step_errors(found.poses, run.true_poses)
    assert away_m.max() < 0.05
