"""Clocks that differ, stamps that were never set, and what the turns of the sweeps tell of an odometry."""

import math

import numpy as np
import pytest

from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.seen_motion.agreement import agreement
from dynmap_cli.ingest.seen_motion.turns import turns_of
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import ODOMETRY, TF, move_stamps, odometry, transform

HOUR_NS = 3600 * 10**9


def shifted(shift_ns):
    """Changes the stamp of a scan, but not when it was recorded."""

    def change(_number, fields):
        move_stamps(fields, shift_ns)

    return change


@pytest.mark.parametrize("shift_ns", [-3 * 10**9, HOUR_NS, -20_000 * HOUR_NS])
@pytest.mark.parametrize("with_tf", [False, True])
def test_scans_on_another_clock_are_put_together_by_the_times_of_recording(shift_ns, with_tf, tmp_path):
    world = Room(with_tf=with_tf, with_odometry=not with_tf, change=shifted(shift_ns))
    log, report = read(tmp_path, world)
    assert report.odometry == ("tf odom -> base_link" if with_tf else "/odom")
    assert "not all clocks are that of /scan" in report.warnings[0]
    assert f"{shift_ns * 1e-9:+.3f} s" in report.warnings[0]
    np.testing.assert_array_equal(log.stamps_ns[:5], world.stamps_ns[:5] + shift_ns)
    np.testing.assert_allclose(log.odometry[:-1], world.poses[: log.n_scans - 1], atol=1e-5)


def test_scans_that_are_recorded_late_but_stamped_well_stay_where_they_are(tmp_path):
    late = Room(with_scans=False, with_odometry=False)
    late.extra = [
        (topic, kind, logged_ns + 3 * 10**9, fields)
        for topic, kind, logged_ns, fields in Room(with_tf=False, with_odometry=False).messages()
    ]
    log, report = read(tmp_path, late)
    assert not any("clock" in line for line in report.warnings)
    np.testing.assert_allclose(log.odometry, late.poses, atol=1e-9)


@pytest.mark.parametrize("source", ["tf", "/odom"])
def test_odometry_whose_stamps_were_never_set_has_the_times_of_recording(source, tmp_path):
    world = Room(with_tf=False, with_odometry=False)
    world.extra = [
        (
            "/tf_static",
            TF,
            world.start_ns,
            {"transforms": [transform("base_link", "laser", 0, world.mounting)]},
        )
    ]
    for logged_ns, (x, y, yaw) in zip(world.stamps_ns.tolist(), world.poses.tolist(), strict=True):
        values = (x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        if source == "tf":
            fields = {"transforms": [transform("odom", "base_link", 0, values)]}
            world.extra.append(("/tf", TF, logged_ns, fields))
        else:
            world.extra.append((source, ODOMETRY, logged_ns, odometry("odom", "base_link", 0, values)))
    log, report = read(tmp_path, world)
    assert "all" in report.warnings[0]
    assert "the same time stamp; the times of recording are used" in report.warnings[0]
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


def with_poses(world, change):
    """The world with an odometry topic whose poses are changed, in place of its own."""
    world.with_tf = world.with_odometry = False
    world.extra = [
        (
            "/tf_static",
            TF,
            world.start_ns,
            {"transforms": [transform("base_link", "laser", 0, world.mounting)]},
        )
    ]
    for stamp_ns, pose in zip(world.stamps_ns.tolist(), world.poses.tolist(), strict=True):
        x, y, yaw = change(*pose)
        values = (x, y, 0.0, 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        world.extra.append(("/odom", ODOMETRY, stamp_ns, odometry("odom", "base_link", stamp_ns, values)))
    return world


@pytest.mark.parametrize(
    "change",
    [lambda x, y, _: (x, y, 0.0), lambda *_: (0.0, 0.0, 0.0), lambda x, y, yaw: (x, y, 57.29578 * yaw)],
    ids=["heading never turns", "never moves", "heading in degrees"],
)
def test_an_odometry_that_does_not_turn_as_the_scans_do_is_not_used(change, tmp_path):
    _, report = read(tmp_path, with_poses(Room(), change))
    assert report.odometry == "none"
    (why,) = report.odometry_rejected
    assert why.startswith("/odom (its heading does not turn as the scans do")


def reversed_beams(_number, fields):
    fields["ranges"] = fields["ranges"][::-1].copy()


def test_a_laser_that_hangs_upside_down_without_saying_so_is_found_by_its_turns(tmp_path):
    world = Room(first_rad=-2.1, change=reversed_beams)
    log, report = read(tmp_path, world)
    (laser,) = report.lasers
    assert laser.upside_down
    assert "its scans turn left where the odometry turns right" in report.warnings[0]
    beams = log.bearings_rad[0]
    np.testing.assert_allclose(np.sort(beams), world.first_rad + 0.035 * np.arange(121), atol=2e-3)
    seen = log.ranges_m[0][np.argsort(beams)]
    np.testing.assert_allclose(seen, world.ranges_m[0], atol=1e-6)


def test_turns_are_those_of_the_laser():
    world = Room()
    laser = RawLaser("/scan")
    shape = ScanShape(world.first_rad, world.step_rad, world.n_beams, 0.1, 20.0)
    for stamp_ns, ranges_m in zip(world.stamps_ns.tolist(), world.ranges_m, strict=True):
        laser.add(stamp_ns, stamp_ns, ranges_m, shape)
    turns = turns_of(laser)
    assert turns.turns_rad.size > 80
    rows = [np.searchsorted(world.stamps_ns, at_ns) for at_ns in (turns.first_ns, turns.second_ns)]
    yaws = world.poses[:, 2]
    off = wrap_angle(turns.turns_rad - (yaws[rows[1]] - yaws[rows[0]]))
    assert np.median(np.abs(off)) < 0.06
    found = agreement(turns, (yaws[rows[0]], yaws[rows[1]]))
    assert found.same_rad < 0.06
    assert 0.3 < found.still_rad < found.opposite_rad
    assert not found.is_mirrored
    assert agreement(turns, (-yaws[rows[0]], -yaws[rows[1]])).is_mirrored


def test_noise_has_no_turns():
    laser = RawLaser("/scan")
    rng = np.random.default_rng(1)
    shape = ScanShape(-2.0, 0.035, 121, 0.1, 20.0)
    for number in range(60):
        laser.add(number * 10**8, number * 10**8, rng.uniform(0.5, 8.0, 121).astype(np.float32), shape)
    assert turns_of(laser).turns_rad.size < 5


def test_a_laser_with_a_few_beams_or_scans_has_no_turns():
    for n_scans, n_beams in ((1, 50), (5, 1), (2, 2)):
        laser = RawLaser("/scan")
        shape = ScanShape(-1.0, 0.02, n_beams, 0.1, 20.0)
        for number in range(n_scans):
            laser.add(number * 10**8, number * 10**8, np.ones(n_beams, dtype=np.float32), shape)
        assert turns_of(laser).turns_rad.size == 0
