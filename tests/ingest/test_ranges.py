"""What range values mean."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynmap_cli.ingest.choices.free_space import Sweeps
from dynmap_cli.ingest.choices.ranges import apply_no_return, find_reach_m
from dynmap_cli.ingest.choices.ranges import judge_no_return as judge_sweeps

any_range = st.floats(width=32, allow_nan=True, allow_infinity=True)


def judge_no_return(ranges, low, high, wish):
    """The verdict without odometry."""
    n_scans, n_beams = ranges.shape
    nowhere = np.full((n_scans, 3), np.nan)
    sweeps = Sweeps(ranges, np.zeros((1, n_beams)), np.zeros(n_scans, dtype=np.int32), nowhere)
    return judge_sweeps(sweeps, low, high, wish)


def plain(value: float, low: float, reach: float, policy: str) -> float:
    """REP 117, one value: in range first, then what lies beyond, then the rest."""
    if low <= value < reach and value > 0.0:
        return value
    if value >= reach and policy == "free":
        return np.inf
    return np.nan


@given(hnp.arrays(np.float32, (3, 7), elements=any_range), st.sampled_from(["free", "ignore"]))
def test_ranges_are_rewritten_as_rep_117_says(ranges, policy):
    low, reach = 0.25, 8.0
    expected = [[plain(float(v), low, reach, policy) for v in row] for row in ranges]
    verdict = judge_no_return(ranges, low, reach, policy)
    found = ranges.copy()
    apply_no_return(found, low, verdict)
    np.testing.assert_array_equal(found, np.array(expected, dtype=np.float32))


@given(hnp.arrays(np.float32, (2, 9), elements=any_range), st.sampled_from(["auto", "free", "ignore"]))
def test_rewriting_twice_changes_nothing_more(ranges, policy):
    verdict = judge_no_return(ranges, 0.1, 10.0, policy)
    apply_no_return(ranges, 0.1, verdict)
    again = ranges.copy()
    apply_no_return(again, 0.1, verdict)
    np.testing.assert_array_equal(again, ranges)


def indoor(n=20_000, far=20.0):
    return np.random.default_rng(1).uniform(0.5, far, (1, n)).astype(np.float32)


def test_a_driver_that_writes_infinity_means_free():
    ranges = indoor()
    ranges[0, ::9] = np.inf
    verdict = judge_no_return(ranges, 0.0, 30.0, "auto")
    assert verdict.policy == "free"
    assert "REP 117" in verdict.why
    assert verdict.share_no_return == np.mean(np.isinf(ranges))


def test_codes_far_beyond_all_returns_say_nothing():
    ranges = indoor()
    ranges[0, ::30] = 81.83
    verdict = judge_no_return(ranges, 0.01, np.inf, "auto")
    assert verdict.policy == "ignore"
    assert 80.0 < verdict.reach_m < 81.83
    apply_no_return(ranges, 0.01, verdict)
    assert np.isnan(ranges[0, ::30]).all()


def test_codes_just_beyond_the_longest_returns_mean_free():
    ranges = indoor(far=80.0)
    ranges[0, ::30] = 81.91
    assert judge_no_return(ranges, 0.01, np.inf, "auto").policy == "free"


def test_zero_never_means_free():
    ranges = indoor()
    ranges[0, ::3] = 0.0
    verdict = judge_no_return(ranges, 0.0, 30.0, "free")
    apply_no_return(ranges, 0.0, verdict)
    assert np.isnan(ranges[0, ::3]).all()


def test_range_max_itself_is_no_return_also_after_rounding():
    ranges = np.array([[np.float32(5.6), 5.5]], dtype=np.float32)
    verdict = judge_no_return(ranges, 0.02, 5.6, "free")
    apply_no_return(ranges, 0.02, verdict)
    np.testing.assert_array_equal(ranges, np.array([[np.inf, 5.5]], dtype=np.float32))


def test_without_codes_the_reach_lies_above_the_largest_value():
    ranges = indoor()
    assert find_reach_m(ranges) > ranges.max()
    assert judge_no_return(ranges, 0.01, np.inf, "auto").share_no_return == 0.0


def test_several_codes_of_one_driver_are_all_found():
    ranges = indoor()
    ranges[0, ::40], ranges[0, 1::40], ranges[0, 2::40] = 81.83, 81.87, 81.91
    reach_m = find_reach_m(ranges)
    assert 20.0 < reach_m <= 81.83


def test_nothing_but_failed_measurements_is_judged():
    verdict = judge_no_return(np.full((2, 5), np.nan, dtype=np.float32), 0.0, np.inf, "auto")
    assert verdict.policy == "ignore"
    assert verdict.share_nothing == 1.0
