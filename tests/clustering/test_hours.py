"""States by hour of the day, from a simulated door that follows the hour to the belief of a localization."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.clustering.hours import with_shares_by_hour
from dynmap_cli.clustering.learning import learn_patch_map
from dynmap_cli.clustering.settings import ClusteringSettings
from dynmap_cli.domain.patches import Patch, Visit
from dynmap_cli.localization.beliefs.priors import prior_at, prior_by_hour
from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.settings import SegmentationSettings
from tests.segmentation.worlds import corridor, door

HOUR_NS = 3600 * 10**9
MONDAY_NS = 20_000 * 24 * HOUR_NS
OPEN_FROM, OPEN_UNTIL = 8, 18
HOURS = (2, 6, 9, 13, 16, 21)
DAYS = 5
LAP_S = 28.0


def visit(number, hour, patch, day=0, start_ns=MONDAY_NS):
    stamp_ns = start_ns + (day * 24 * 3600 + round(hour * 3600)) * 10**9
    return Visit(0, number, "log", stamp_ns, stamp_ns + 10**10, patch, 1.0)


def office_door(days=DAYS, start_ns=MONDAY_NS):
    """Open (patch 1) by day and closed (patch 0) by night, seen at six hours each day."""
    return [
        visit(number, hour, int(OPEN_FROM <= hour < OPEN_UNTIL), day, start_ns)
        for number, (day, hour) in enumerate((day, hour) for day in range(days) for hour in HOURS)
    ]


def patches(supports=(15, 15)):
    return tuple(
        Patch(number, support, np.zeros((3, 4), dtype=np.float32)) for number, support in enumerate(supports)
    )


def test_a_door_that_follows_the_hour():
    closed, opened = with_shares_by_hour(patches(), office_door())
    np.testing.assert_allclose(np.add(closed.share_by_hour, opened.share_by_hour), 1.0, atol=2e-6)
    assert min(opened.share_by_hour[hour] for hour in (9, 13, 16)) > 0.8
    assert max(opened.share_by_hour[hour] for hour in (2, 6, 21)) < 0.2
    assert opened.share_by_hour[11] == pytest.approx(0.5, abs=0.25)


def test_shares_are_those_of_a_plain_sum_around_the_clock():
    visits = office_door()
    found = with_shares_by_hour(patches(), visits)
    for hour in range(24):
        sums = [2.0 * 16 / 32, 2.0 * 16 / 32]
        for one in visits:
            at = one.start_ns % (24 * HOUR_NS) / HOUR_NS + 5 / 3600
            apart = abs(hour + 0.5 - at)
            sums[one.patch] += np.exp(-0.5 * min(apart, 24 - apart) ** 2)
        assert found[1].share_by_hour[hour] == pytest.approx(sums[1] / sum(sums), abs=1e-6)


@pytest.mark.parametrize(
    "visits",
    [
        office_door(days=4),
        office_door()[:29],
        office_door(start_ns=0),
        [replace(one, patch=None) for one in office_door()],
    ],
    ids=["four days", "29 visits", "clock without a date", "no states"],
)
def test_too_little_says_nothing(visits):
    assert [patch.share_by_hour for patch in with_shares_by_hour(patches(), visits)] == [(), ()]


def test_priors_by_hour_by_support_and_uniform():
    by_hour = prior_by_hour(with_shares_by_hour(patches((9, 21)), office_door()), "hour")
    np.testing.assert_allclose(by_hour.sum(axis=1), 1.0)
    assert prior_at(by_hour, MONDAY_NS + 13 * HOUR_NS)[1] > 0.8
    assert prior_at(by_hour, MONDAY_NS + 21 * HOUR_NS)[1] < 0.25
    assert prior_at(by_hour, 5)[1] == pytest.approx(by_hour[:24, 1].mean())
    by_support = prior_by_hour(patches((9, 21)), "support")
    np.testing.assert_allclose(prior_at(by_support, MONDAY_NS), [10 / 32, 22 / 32])
    np.testing.assert_array_equal(prior_by_hour(patches((9, 21)), "hour"), by_support)
    np.testing.assert_array_equal(prior_at(prior_by_hour(patches((9, 21)), "uniform"), 5), [0.5, 0.5])


def test_a_simulated_door_that_follows_the_hour_is_learned():
    """Thirty laps, of which each is moved to its hour of its day."""
    laps = [(day, hour) for day in range(DAYS) for hour in HOURS]
    is_open = [OPEN_FROM <= hour < OPEN_UNTIL for _, hour in laps]
    changes = [LAP_S * lap for lap in range(1, len(laps)) if is_open[lap] != is_open[lap - 1]]
    run, frame = corridor(
        doors=[door("south", [3, 0], [4, 0], -90, changes)], repeat=len(laps), beams=81, rate_hz=2
    )
    seconds = (run.log.stamps_ns - run.log.stamps_ns[0]) / 1e9
    lap = np.minimum((seconds / LAP_S).astype(int), len(laps) - 1)
    begin_ns = np.array([MONDAY_NS + (24 * day + hour) * HOUR_NS for day, hour in laps])
    stamps_ns = begin_ns[lap] + ((seconds - LAP_S * lap) * 1e9).astype(np.int64)
    log = replace(run.log, stamps_ns=stamps_ns)
    submaps, _ = find_submaps(log, run.true_poses, frame, SegmentationSettings())
    (patch_set,), visits = learn_patch_map(log, run.true_poses, submaps, ClusteringSettings())
    assert len(patch_set.patches) == 2
    opened = min(patch_set.patches, key=lambda patch: np.nansum(patch.reflectance * patch_set.varying))
    assert len(visits) >= len(laps)
    assert min(opened.share_by_hour[hour] for hour in (9, 13, 16)) > 0.8
    assert max(opened.share_by_hour[hour] for hour in (2, 6, 21)) < 0.2
