"""Laws of the measures of beams."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.beams import by_probability, calibration_error, harmonic, measures, score_beams
from dynmap_cli.evaluation.truth import same_scans
from tests.evaluation.worlds import room


def test_true_labels_are_perfect():
    score = score_beams("truth", *room())
    assert score.values.pop("calibration_error") == 0.0
    assert set(score.values.values()) == {1.0}
    assert score.is_complete


def test_shuffled_labels_are_not():
    run, truth = room()
    shuffled = np.random.default_rng(1).permutation(run.static_probability.ravel()).reshape(60, 90)
    score = score_beams("shuffled", replace(run, static_probability=np.nan_to_num(shuffled, nan=1.0)), truth)
    assert score.values["F1"] < 0.2


def test_the_filter_beats_nothing_and_ablations_are_there():
    score = score_beams("truth", *room())
    rows = {row["method"]: row for row in score.details["methods at the same poses"]}
    assert set(rows) == {
        "run",
        "run, without unknown beams",
        "without looks",
        "without watches",
        "with grazing beams",
        "plain counting",
        "paper to the letter",
    }
    assert rows["paper to the letter"]["dynamic_found_DA"] > 0.9
    assert rows["paper to the letter"]["static_kept_SA"] > 0.9


def test_unknown_beams_are_kept_and_counted_apart():
    run, truth = room()
    e = np.where(truth.beam_class == truth.moving, np.float32(0.9), run.static_probability)
    is_unknown = np.asarray(truth.beam_class == truth.moving)
    is_unknown[::2] = False
    score = score_beams("unknown", replace(run, static_probability=e, is_unknown=is_unknown), truth)
    assert score.values["dynamic_found_DA"] == 0.0
    rows = {row["method"]: row for row in score.details["methods at the same poses"]}
    assert rows["run, without unknown beams"]["static_kept_SA"] == 1.0
    shares = {row["class"]: row["unknown"] for row in score.details["by class"]}
    assert shares["moving"] == pytest.approx(0.5)
    assert shares["static"] == 0.0


@given(
    e=hnp.arrays(np.float32, 300, elements=st.floats(0.0, 1.0, width=32)),
    kinds=hnp.arrays(np.int8, 300, elements=st.integers(0, 2)),
)
def test_every_beam_that_counts_is_in_one_bin(e, kinds):
    rows = by_probability(e, kinds == 0, kinds == 1)
    assert sum(row["beams"] for row in rows) == int((kinds < 2).sum())
    for row in rows:
        low, high = map(float, row["static_probability"].split("-"))
        assert row["beams"] == 0 or low - 1e-6 <= row["mean"] <= high + 1e-6


def test_calibration_error_is_the_distance_of_said_and_true_share():
    e, kinds = np.full(1000, 0.8, dtype=np.float32), np.arange(1000) % 10
    assert calibration_error(e, kinds < 8, kinds >= 8) == pytest.approx(0.0, abs=1e-6)
    assert calibration_error(e, kinds < 5, kinds >= 5) == pytest.approx(0.3, abs=1e-6)


def test_a_beam_without_label_counts_as_wrong_and_lowers_the_coverage():
    run, truth = room()
    gaps = run.static_probability.copy()
    gaps[:30] = np.nan
    score = score_beams("gaps", replace(run, static_probability=gaps), truth)
    assert score.values["static_kept_SA"] == pytest.approx(0.5, abs=0.02)
    assert not score.is_complete


def test_scans_that_the_run_left_out_lower_the_coverage():
    run, truth = room()
    part = replace(
        run,
        log=run.log.select(slice(0, 40)),
        poses=run.poses[:40],
        static_probability=run.static_probability[:40],
    )
    assert score_beams("part", part, truth).coverage == pytest.approx(40 / 60)


def test_truth_of_another_recording_is_refused():
    run, truth = room()
    other = replace(truth, trajectory=Trajectory(truth.trajectory.stamps_ns + 10**12, truth.trajectory.poses))
    with pytest.raises(ArtifactError, match="no scan has a time"):
        score_beams("other", run, other)
    turned = replace(truth, beam_class=np.roll(truth.beam_class, 45, axis=1))
    with pytest.raises(ArtifactError, match="nothing came back"):
        score_beams("turned", run, turned)


def test_ranges_and_classes_add_up():
    run, truth = room()
    score = score_beams("truth", run, truth)
    moving = int((truth.beam_class == 1).sum())
    assert sum(row["moving"] for row in score.details["by range"]) == moving
    assert {row["class"]: row["beams"] for row in score.details["by class"]}["moving"] == moving


@given(
    hnp.arrays(np.int8, 40, elements=st.integers(-1, 1)),
    hnp.arrays(np.bool_, 40),
)
def test_measures_match_a_plain_count(labels, is_moving):
    is_static = ~is_moving
    result = measures(labels, is_static, is_moving)
    kept = sum(1 for label, s in zip(labels, is_static, strict=True) if s and label == 1)
    found = sum(1 for label, m in zip(labels, is_moving, strict=True) if m and label == 0)
    if is_static.any():
        assert result["static_kept_SA"] == kept / is_static.sum()
    if is_moving.any():
        assert result["dynamic_found_DA"] == result["recall"] == found / is_moving.sum()
    assert np.isnan(result["F1"]) or 0.0 <= result["F1"] <= 1.0


def test_a_harmonic_mean_lies_between_and_nan_stays_nan():
    assert harmonic(0.5, 1.0) == pytest.approx(2 / 3)
    assert harmonic(0.0, 0.0) == 0.0
    assert np.isnan(harmonic(np.nan, 1.0))


def test_equal_stamps_meet_in_order():
    _, truth = room()
    stamps = truth.trajectory.stamps_ns.copy()
    stamps[5] = stamps[4]
    twice = replace(truth, trajectory=Trajectory(stamps, truth.trajectory.poses))
    mine, theirs = same_scans(stamps, twice)
    np.testing.assert_array_equal(mine, theirs)
