"""People who come back to the same spot make a sub-map; who stands somewhere once, or only passes, does not."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.recurring import occasions
from dynmap_cli.segmentation.settings import SegmentationSettings
from tests.segmentation.worlds import corridor

DAYS, DAY_NS = 8, 86_400_000_000_000
SPOT = (9.6, 0.55)


def stands_on(days, day_s, from_s=0.0, to_s=None):
    """Somebody who stands at the spot on these days."""
    return [
        {
            "does": "stand",
            "at": list(SPOT),
            "from_s": day * day_s + from_s,
            "to_s": (day * day_s + to_s) if to_s else (day + 1) * day_s,
        }
        for day in days
    ]


def found_on_days(movers_of, apart_ns=DAY_NS):
    """Sub-maps of eight laps, each on a day of its own."""
    bare, _ = corridor(repeat=DAYS)
    day_s = float(bare.log.stamps_ns[-1] - bare.log.stamps_ns[0]) * 1e-9 / DAYS
    run, frame = corridor(movers=movers_of(day_s), repeat=DAYS)
    seconds = (run.log.stamps_ns - run.log.stamps_ns[0]) * 1e-9
    day = np.minimum(seconds // day_s, DAYS - 1).astype(np.int64)
    log = replace(run.log, stamps_ns=run.log.stamps_ns + day * apart_ns)
    return find_submaps(log, run.true_poses, frame, SegmentationSettings())


def test_somebody_at_the_same_spot_on_most_days_is_a_submap():
    submaps, _ = found_on_days(lambda day_s: stands_on([0, 1, 3, 5, 6], day_s))
    (submap,) = submaps
    assert submap.recurring is not None
    assert np.hypot(*(np.array(submap.center_m) - SPOT)) < 0.3
    assert max(submap.size_m) < 1.6


@pytest.mark.parametrize(
    "movers_of",
    [
        lambda day_s: stands_on([2], day_s),
        lambda day_s: stands_on([2, 5], day_s),
        lambda day_s: stands_on(range(DAYS), day_s, 3.0, 7.0),
    ],
    ids=["one day", "two days", "a moment on each day"],
)
def test_who_stays_seldom_or_only_for_a_moment_is_none(movers_of):
    submaps, _ = found_on_days(movers_of)
    assert submaps == ()


def test_days_that_follow_one_another_within_an_hour_are_one_occasion():
    submaps, found = found_on_days(lambda day_s: stands_on([0, 1, 3, 5, 6], day_s), apart_ns=0)
    assert set(occasions(found.windows.starts_ns).tolist()) == {0}
    assert not any(submap.recurring is not None for submap in submaps)


def test_an_occasion_begins_an_hour_after_the_last_one_began():
    minutes = np.array([0, 30, 59, 60, 119, 121, 2000, 40])
    starts = (minutes * 60_000_000_000).astype(np.int64)
    assert occasions(starts).tolist() == [0, 0, 0, 1, 1, 2, 3, 0]
    assert occasions(np.empty(0, dtype=np.int64)).size == 0
