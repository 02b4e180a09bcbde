"""Robots that start in rooms which the map does not show, and what confirms a place."""

import numpy as np
import pytest

from dynmap_cli.localization.particles.particle_filter import Estimate
from dynmap_cli.localization.watching.doubts import began_outside
from dynmap_cli.localization.watching.health import SETTLED_AFTER, Patience, ScanHealth, Verdict
from dynmap_cli.localization.watching.placement import CONFIRMED_AFTER, Placement
from dynmap_cli.simulation.run import simulate
from tests.localization.test_unmapped import WING_X_M, building, hall_of, localize
from tests.localization.worlds import pose_errors

SURE = Estimate(np.zeros(3), 1.0, 0.05, 0.05)
FITS, OUTSIDE = (
    ScanHealth(1.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ScanHealth(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, off_map=1.0),
)
CONTRADICTED = ScanHealth(0.6, 0.0, 0.4, 0.3, 0.0, 0.0)


@pytest.fixture(scope="module")
def run():
    return simulate(building(rounds=1))


@pytest.mark.parametrize("from_x_m", [13.0, 18.5])
def test_who_starts_in_a_room_never_mapped_is_nowhere_until_it_comes_into_the_map_and_is_then_found(
    run, from_x_m
):
    first = int(np.flatnonzero(run.true_poses[:, 0] > from_x_m)[0])
    true, log = run.true_poses[first:], run.log.select(slice(first, len(run.true_poses)))
    found = localize(run, hall_of(run), log=log)
    away_m, _ = pose_errors(found.trajectory.poses, true)
    scans = np.searchsorted(log.stamps_ns, [row.stamp_ns for row in found.health])
    is_lost = np.array([row.verdict == "lost" for row in found.health])
    assert is_lost[away_m[scans] > 0.3].all()
    assert not is_lost[away_m[scans] <= 0.3].all()
    in_hall = np.flatnonzero(true[:, 0] < WING_X_M)
    way_m = np.cumsum(np.hypot(*np.diff(true[in_hall, :2], axis=0).T))
    there = in_hall[1:][way_m > 7.0]
    assert there.size > 50
    assert away_m[there].max() < 0.2
    assert "not in the map until t = " in began_outside(found.health, int(found.trajectory.stamps_ns[0]))


def test_who_starts_in_the_map_and_leaves_it_at_once_stays_where_it_is(run):
    """Too soon for the place to be confirmed: it is said to be unsure, but not put elsewhere."""
    leave = int(np.flatnonzero(run.true_poses[:, 0] > WING_X_M)[0])
    first = leave - 45
    true, log = run.true_poses[first : leave + 60], run.log.select(slice(first, leave + 60))
    away_m, _ = pose_errors(localize(run, hall_of(run), log=log).trajectory.poses, true)
    assert away_m.max() < 0.3


def test_where_the_map_knows_nothing_a_place_is_lost_until_it_was_confirmed():
    verdict = Verdict()
    assert verdict.judge(OUTSIDE, SURE) == "lost"
    assert verdict.is_off_map
    verdict = Verdict()
    for _ in range(CONFIRMED_AFTER):
        assert not verdict.placement.is_confirmed
        assert verdict.judge(FITS, SURE) == "tracking"
    assert {verdict.judge(OUTSIDE, SURE) for _ in range(20)} == {"tracking"}
    assert Verdict(is_given=True).judge(OUTSIDE, SURE) == "tracking"


def test_a_contradiction_begins_the_count_anew_and_scans_that_say_nothing_confirm_nothing():
    verdict = Verdict()
    for scan in [FITS] * (CONFIRMED_AFTER - 1) + [CONTRADICTED] * 6:
        verdict.judge(scan, SURE)
    assert not verdict.placement.speaks_for_it
    place = Placement()
    for _ in range(3 * CONFIRMED_AFTER):
        place.see(0.1, 0.9)
        place.judge(is_in_doubt=False)
    assert not place.is_confirmed


def test_who_is_not_in_the_map_is_searched_for_again_and_again():
    patience = Patience()
    searches = [k for k in range(20 * SETTLED_AFTER) if patience.is_over(is_in_doubt=True, is_off_map=True)]
    assert np.diff(searches).max() == SETTLED_AFTER
