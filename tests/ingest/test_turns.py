"""Turns of sweeps, fast and plain, and which odometry they let be believed."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import wrap_angle
from dynmap_cli.ingest.choices.odometry import _turns_otherwise
from dynmap_cli.ingest.raw.laser import RawLaser, ScanShape
from dynmap_cli.ingest.seen_motion.agreement import agreement, agreement_at, chance_of
from dynmap_cli.ingest.seen_motion.laid_sweeps import _left_m, share_nearer
from dynmap_cli.ingest.seen_motion.pairs import SweepPairs
from dynmap_cli.ingest.seen_motion.turns import Headings, ScanTurns, _best_shifts, turns_of
from tests.ingest.rooms import Room
from tests.reference import seen_motion


def test_shifts_are_those_of_the_plain_search_also_where_beams_are_missing():
    rng = np.random.default_rng(3)
    for missing in (0.0, 0.2):
        before = (5.0 + rng.normal(0.0, 0.2, (12, 200)).cumsum(axis=1)).astype(np.float32)
        shifts = rng.integers(-25, 25, 12)
        after = np.array([np.roll(row, -shift) for row, shift in zip(before, shifts, strict=True)])
        after[rng.random(after.shape) < missing] = np.nan
        found, is_told = _best_shifts(before, after, 30)
        np.testing.assert_array_equal(found, shifts)
        assert is_told.all()
        assert [
            seen_motion.best_shift(*pair, 30) for pair in zip(before, after, strict=True)
        ] == shifts.tolist()


def laser_of(ranges_m, first_rad, step_rad, rate_hz=10):
    """A laser with these sweeps (n, n_beams), and their stamps (n,)."""
    laser = RawLaser("/scan")
    shape = ScanShape(first_rad, step_rad, ranges_m.shape[1], 0.1, 20.0)
    stamps_ns = np.arange(ranges_m.shape[0]) * (10**9 // rate_hz)
    for stamp_ns, row in zip(stamps_ns.tolist(), ranges_m.astype(np.float32), strict=True):
        laser.add(stamp_ns, stamp_ns, row, shape)
    return laser, stamps_ns


def judged(laser, stamps_ns, poses):
    """Whether an odometry is not believed, and whether the laser is taken to hang the other way up."""
    turns = turns_of(laser, Headings(stamps_ns, [poses]))
    found = agreement_at(turns, stamps_ns, poses)
    return bool(_turns_otherwise(turns, stamps_ns, poses)), found.is_mirrored


def with_headings(poses, yaws):
    return np.column_stack([poses[:, :2], yaws])


FIRST_RAD, STEP_RAD = -2.1, 0.035
ANGLES = FIRST_RAD + STEP_RAD * np.arange(121)
NOISE = np.random.default_rng(4)


def around(radius_m, n_scans):
    """Poses (n, 3) on the way around a circle, 10 cm from one to the next."""
    angles = np.linspace(0.0, n_scans * 0.1 / radius_m, n_scans)
    return np.column_stack(
        [radius_m * np.cos(angles), radius_m * np.sin(angles), wrap_angle(angles + np.pi / 2)]
    )


def hall(poses, radius_m):
    """Ranges (n, 121) in a round hall."""
    along = poses[:, 2, None] + ANGLES
    middle_m = poses[:, 0, None] * np.cos(along) + poses[:, 1, None] * np.sin(along)
    outside = radius_m**2 - (poses[:, :2] ** 2).sum(axis=1)[:, None]
    return np.sqrt(middle_m**2 + outside) - middle_m + NOISE.normal(0.0, 0.01, along.shape)


def test_odometry_is_believed_in_a_round_hall_where_all_sweeps_look_alike():
    poses = around(4.0, 600)
    laser, stamps_ns = laser_of(hall(poses, 6.0), FIRST_RAD, STEP_RAD)
    turns = turns_of(laser, Headings(stamps_ns, [poses]))
    found = agreement_at(turns, stamps_ns, poses)
    assert found.n_pairs > 40
    assert found.still_rad < 0.5 * found.same_rad
    assert judged(laser, stamps_ns, poses) == (False, False)
    assert judged(laser, stamps_ns, with_headings(poses, -poses[:, 2])) == (True, False)


def drive():
    """Poses (n, 3) through the room and what is seen, now and then straight on for a while."""
    world = Room(n_scans=400)
    return world.poses, world.ranges_m


@pytest.mark.parametrize("share", [0.0, 0.7])
def test_odometry_is_believed_among_people_who_go_with_the_robot(share):
    """Those seen in most beams turn as the robot does; what is seen between them tells that it turns."""
    poses, ranges_m = drive()
    is_person = np.random.default_rng(2).random(121) < share
    ranges_m[:, is_person] = 1.0 + NOISE.normal(0.0, 0.01, (400, np.count_nonzero(is_person)))
    laser, stamps_ns = laser_of(ranges_m, FIRST_RAD, STEP_RAD)
    assert judged(laser, stamps_ns, poses) == (False, False)
    later = np.roll(poses[:, 2], 23)
    assert judged(laser, stamps_ns, with_headings(poses, later)) == (True, False)


WRONG = {
    "heading never turns": lambda poses: with_headings(poses, np.zeros(len(poses))),
    "stands still": np.zeros_like,
    "of another drive": lambda poses: poses[::-1].copy(),
    "two seconds late": lambda poses: np.roll(poses, 20, axis=0),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG.keys())
def test_odometry_that_is_not_of_the_drive_is_not_believed(change):
    poses, ranges_m = drive()
    laser, stamps_ns = laser_of(ranges_m, FIRST_RAD, STEP_RAD)
    assert judged(laser, stamps_ns, change(poses)) == (True, False)


GOOD = {
    "turns counted double": lambda poses: with_headings(poses, wrap_angle(2.0 * np.unwrap(poses[:, 2]))),
    "half of the turns": lambda poses: with_headings(poses, 0.5 * np.unwrap(poses[:, 2])),
    "a fifth of a second late": lambda poses: np.roll(poses, 2, axis=0),
}


@pytest.mark.parametrize("change", GOOD.values(), ids=GOOD.keys())
def test_odometry_that_mapping_can_mend_is_believed(change):
    poses, ranges_m = drive()
    laser, stamps_ns = laser_of(ranges_m, FIRST_RAD, STEP_RAD)
    assert judged(laser, stamps_ns, change(poses)) == (False, False)


def rare_turns(n_scans, turn_rad, n_steps):
    """Headings (n,): every two minutes a turn there, and a little later back again."""
    steps = np.zeros(n_scans)
    for begin in range(200, n_scans - 200, 1200):
        steps[begin : begin + n_steps] = turn_rad / n_steps
        steps[begin + 100 : begin + 100 + n_steps] = -turn_rad / n_steps
    return np.cumsum(steps)


@pytest.mark.parametrize(("turn_deg", "n_steps"), [(90.0, 15), (160.0, 5)])
def test_a_laser_upside_down_is_found_where_the_robot_hardly_ever_turns_or_turns_fast(turn_deg, n_steps):
    """An even choice of pairs would have some two in turns; half a second of the fast ones is out of reach."""
    yaws = rare_turns(9000, np.radians(turn_deg), n_steps)
    walls = 4.0 + np.random.default_rng(7).normal(0.0, 0.2, 3600).cumsum() % 6.0
    walls = np.convolve(np.r_[walls, walls], np.ones(30) / 30, mode="same")
    beams = np.round(np.degrees(yaws[:, None] + ANGLES) * 10).astype(np.int64) % 3600
    laser, stamps_ns = laser_of(walls[beams], FIRST_RAD, STEP_RAD)
    poses = with_headings(np.zeros((9000, 2)), yaws)
    assert judged(laser, stamps_ns, poses) == (False, False)
    assert judged(laser, stamps_ns, with_headings(poses, -yaws)) == (False, True)


@pytest.mark.parametrize("step_rad", [STEP_RAD, -STEP_RAD, 2.0 * np.pi / 121])
def test_what_a_motion_leaves_is_what_the_plain_search_finds(step_rad):
    rng = np.random.default_rng(5)
    bearings = -0.5 * 120 * step_rad + step_rad * np.arange(121)
    before, after = (rng.uniform(1.0, 1.3, (6, 121)).astype(np.float32) for _ in range(2))
    before[rng.random(before.shape) < 0.1] = np.nan
    after[rng.random(after.shape) < 0.1] = np.nan
    after[3] = np.nan
    pairs = SweepPairs(before, after, bearings)
    motions, others = (
        np.column_stack([rng.normal(0.0, 0.3, (6, 2)), rng.uniform(-3.0, 3.0, 6)]) for _ in range(2)
    )
    plain = [
        seen_motion.left_m(*pair, bearings, motion)
        for *pair, motion in zip(before, after, motions, strict=True)
    ]
    np.testing.assert_allclose(_left_m(pairs, np.arange(6), motions), plain, atol=1e-6)
    share = share_nearer(pairs, motions, others)
    assert share == pytest.approx(seen_motion.share_nearer(before, after, bearings, motions, others))
    assert share == -share_nearer(pairs, others, motions)
    assert share != 0.0


def test_the_chance_of_a_sign_test_is_that_of_coins():
    assert chance_of(0, 7) == 1.0
    assert chance_of(10, 10) == pytest.approx(1 / 1024)
    assert chance_of(2, 3) == pytest.approx(0.5)


def test_pairs_that_overlap_count_once():
    """Twenty pairs within a second say no more than two."""
    first_ns = np.arange(20) * 50_000_000
    values = np.ones((20, 3), dtype=np.float32)
    pairs = SweepPairs(values, values, np.arange(3) * 0.1)
    turns = ScanTurns(first_ns, first_ns + 500_000_000, np.full(20, 0.3), pairs)
    found = agreement(turns, (np.zeros(20), np.full(20, -0.3)))
    assert found.n_pairs == 2
    assert found.opposite == 1.0
    assert not found.is_mirrored
