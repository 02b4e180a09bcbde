"""Laws of the measures of a localization."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import Trajectory, compose, inverse
from dynmap_cli.evaluation.believed_states import Believed, combination_accuracy, state_measures
from dynmap_cli.evaluation.localization import (
    Clouds,
    Localized,
    first_settled,
    read_localized,
    score_localization,
    weighted_errors,
)
from dynmap_cli.evaluation.object_beliefs import BelievedObject
from dynmap_cli.files.trajectory import write_tum
from tests.evaluation.test_states import door


def perfect(truth):
    stamps = truth.trajectory.stamps_ns
    belief = Believed(stamps, truth.object_states[:, 0].astype(np.int64), np.ones(stamps.size))
    return Localized(truth.trajectory, {0: belief}, stamps, np.zeros(stamps.size, bool), None)


def test_truth_against_itself_is_perfect():
    learned, truth = door()
    values = score_localization("truth", perfect(truth), truth, learned, truth).values
    assert values["success"] == values["state_accuracy"] == values["state_changes_noticed_share"] == 1.0
    for name in ("time_to_converge_s", "position_error_mean_m", "false_alarm_share", "state_delay_median_s"):
        assert values[name] == pytest.approx(0.0, abs=1e-12), name


def test_the_frame_of_the_map_does_not_matter():
    learned, truth = door((3.0, -2.0, 1.0))
    turned = compose(inverse(learned.truth_from_map), truth.trajectory.poses)
    localized = replace(perfect(truth), trajectory=Trajectory(truth.trajectory.stamps_ns, turned))
    values = score_localization("turned", localized, truth, learned, truth).values
    assert values["position_error_mean_m"] == pytest.approx(0.0, abs=1e-9)
    assert score_localization("not told", localized, truth).values["success"] == 0.0


def test_shuffled_truth_fails():
    _, truth = door()
    order = np.random.default_rng(0).permutation(80)
    shuffled = Trajectory(truth.trajectory.stamps_ns, truth.trajectory.poses[order])
    score = score_localization("shuffled", replace(perfect(truth), trajectory=shuffled), truth)
    assert score.values["success"] == 0.0
    assert np.isnan(score.values["time_to_converge_s"])


def test_missing_poses_are_not_good():
    _, truth = door()
    half = Trajectory(truth.trajectory.stamps_ns[:40], truth.trajectory.poses[:40])
    score = score_localization("half", replace(perfect(truth), trajectory=half), truth)
    assert score.coverage == 0.5
    assert score.values["right_share_after"] == 0.5
    assert score.values["success"] == 0.0


def test_late_convergence_is_timed():
    _, truth = door()
    poses = truth.trajectory.poses.copy()
    poses[:10, 1] += 5.0
    late = replace(perfect(truth), trajectory=Trajectory(truth.trajectory.stamps_ns, poses))
    values = score_localization("late", late, truth).values
    assert values["time_to_converge_s"] == 10.0
    assert values["success"] == 1.0


def test_convergence_needs_seconds_of_right_poses():
    stamps = np.arange(10, dtype=np.int64) * 10**9
    good = np.array([0, 1, 1, 0, 1, 1, 1, 1, 0, 0], dtype=bool)
    assert first_settled(stamps, good) == 4
    assert first_settled(stamps, good & (np.arange(10) != 5)) is None


def test_false_alarms_and_found_losses():
    _, truth = door()
    poses = truth.trajectory.poses.copy()
    poses[60:, 0] += 3.0
    says_lost = np.zeros(80, bool)
    says_lost[[3, *range(70, 80)]] = True
    localized = replace(
        perfect(truth), trajectory=Trajectory(truth.trajectory.stamps_ns, poses), says_lost=says_lost
    )
    values = score_localization("lost", localized, truth).values
    assert values["false_alarm_share"] == pytest.approx(1 / 60)
    assert values["lost_found_share"] == pytest.approx(0.5)
    assert values["lost_share"] == pytest.approx(0.25)


def test_a_belief_that_follows_late_has_a_delay():
    learned, truth = door()
    stamps = truth.trajectory.stamps_ns
    late = np.concatenate([np.zeros(2, np.int64), truth.object_states[:-2, 0].astype(np.int64)])
    values = state_measures({0: Believed(stamps, late, np.ones(80))}, truth, learned, truth)
    assert values["state_delay_median_s"] == pytest.approx(2.0)
    assert values["state_changes_in_view"] == 7
    assert values["state_accuracy"] == pytest.approx((80 - 14) / 80)
    assert values["state_mapped_share"] == 1.0
    assert values["state_accuracy_when_mapped"] == values["state_accuracy"]


def test_a_combination_is_right_where_its_patch_is_or_all_objects_in_view_are():
    """A door that was only mapped open; every other belief in its object is wrong, or out of view."""
    learned, truth = door()
    stamps, closed = truth.trajectory.stamps_ns, truth.object_states[:, 0]
    (number,) = {visit.submap_id for visit in learned.visits}
    open_only = replace(learned, visits=tuple(visit for visit in learned.visits if visit.patch == 0))
    shares = {(number, 3): {("door", "open"): 0.0, ("door", "closed"): 1.0}}
    never = np.where(closed == 0, 0, -1)
    believed = {number: Believed(stamps, never, np.ones(80))}

    def accuracy(seen, probability, own=shares):
        objects = {(number, 3): BelievedObject(stamps[seen], probability[seen])}
        return combination_accuracy(believed, objects, own, truth, open_only, truth)

    right, every = closed.astype(np.float64), np.ones(80, dtype=bool)
    known = float((never == 0).mean())
    assert accuracy(every, right) == 1.0
    assert accuracy(every, 1.0 - right) == pytest.approx(known)
    assert accuracy(~every, right) == pytest.approx(known)
    assert accuracy(every, right, {(number, 3): {("door", "open"): 0.0}}) == pytest.approx(known)
    half = np.arange(80) % 2 == 0
    assert accuracy(half, right) == pytest.approx(float(((never == 0) | half).mean()))


def test_where_nothing_changes_there_is_no_delay():
    learned, truth = door()
    stamps = truth.trajectory.stamps_ns
    still = replace(truth, object_states=np.zeros_like(truth.object_states))
    belief = Believed(stamps, np.zeros(80, np.int64), np.ones(80))
    values = state_measures({0: belief}, still, learned, truth)
    assert values["state_changes_in_view"] == 0
    assert values["state_accuracy"] == 1.0
    assert np.isnan(values["state_delay_median_s"])


def test_weighted_error_matches_a_plain_sum():
    _, truth = door()
    draw = np.random.default_rng(1)
    stamps = truth.trajectory.stamps_ns[[3, 9]]
    update = np.array([0, 0, 0, 1, 1])
    poses, weights = draw.normal(size=(5, 3)), draw.random(5)
    found = weighted_errors(Clouds(stamps, update, poses, weights), truth, np.zeros(3))
    for number, scan in enumerate((3, 9)):
        true = truth.trajectory.poses[scan]
        mine = [
            (w, np.hypot(p[0] - true[0], p[1] - true[1]))
            for p, w, u in zip(poses, weights, update, strict=True)
            if u == number
        ]
        assert found[number] == pytest.approx(sum(w * d for w, d in mine) / sum(w for w, _ in mine))


def test_reading_what_localize_writes(tmp_path):
    _, truth = door()
    write_tum(tmp_path / "trajectory.tum", truth.trajectory)
    (tmp_path / "states.csv").write_text(
        "stamp_s,submap,patch,probability\n1.000000000,0,0,0.3\n1.000000000,0,1,0.7\n"
    )
    header = (
        "stamp_s,explained,explained_by_other_state,unexplained,log_likelihood_per_beam,"
        "effective_particles,patch_entropy_bits,verdict\n"
    )
    (tmp_path / "health.csv").write_text(header + "1.0,1,0,0,-1,10,0,lost\n")
    localized = read_localized(tmp_path)
    assert localized.believed[0].patches.tolist() == [1]
    assert localized.says_lost.tolist() == [True]
