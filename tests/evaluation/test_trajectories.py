"""Laws of ATE, RPE and relations; evo as oracle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynmap_cli.domain.poses import Trajectory, between, compose, wrap_angle
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.association import associate, nearest_stamp
from dynmap_cli.evaluation.relations import Relations, read_relations, relation_errors, score_relations
from dynmap_cli.evaluation.trajectories import align, read_reference, score_trajectory

SEEDS = st.integers(0, 10_000)


def walk(seed, count=120):
    """A path of a robot that turns now and then."""
    draw = np.random.default_rng(seed)
    yaw = wrap_angle(draw.uniform(-3, 3) + np.cumsum(draw.normal(0.0, 0.3, count)))
    steps = draw.uniform(0.0, 0.4, count)
    poses = np.column_stack([np.cumsum(steps * np.cos(yaw)), np.cumsum(steps * np.sin(yaw)), yaw])
    stamps = 10**18 + np.cumsum(draw.integers(150_000_000, 250_000_000, count))
    return Trajectory(stamps.astype(np.int64), poses)


def shaken(trajectory, seed, sigma=0.05):
    noise = np.random.default_rng(seed).normal(0.0, sigma, trajectory.poses.shape)
    return Trajectory(trajectory.stamps_ns, compose(trajectory.poses, noise))


def relations_of(trajectory, seed, count=50):
    first, second = np.random.default_rng(seed).integers(0, trajectory.stamps_ns.size, (2, count))
    poses = between(trajectory.poses[first], trajectory.poses[second])
    return Relations(trajectory.stamps_ns[first], trajectory.stamps_ns[second], poses)


@given(SEEDS)
def test_truth_against_itself_is_perfect(seed):
    truth = walk(seed)
    score = score_trajectory("truth", truth, truth)
    errors = [value for name, value in score.values.items() if name != "poses"]
    np.testing.assert_allclose(errors, 0.0, atol=1e-9)
    assert score.coverage == 1.0
    of_relations = score_relations("truth", truth, relations_of(truth, seed))
    assert of_relations.values["translation_max_m"] < 1e-9
    assert of_relations.values["rotation_max_deg"] < 1e-9


@given(SEEDS)
def test_shuffled_truth_is_not(seed):
    truth = walk(seed)
    order = np.random.default_rng(seed).permutation(truth.stamps_ns.size)
    shuffled = Trajectory(truth.stamps_ns, truth.poses[order])
    assert score_trajectory("shuffled", shuffled, truth).values["ate_rmse_m"] > 0.1
    assert score_relations("shuffled", shuffled, relations_of(truth, seed)).values["translation_mean_m"] > 0.1


@given(SEEDS, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
def test_no_rigid_motion_of_the_estimate_changes_a_number(seed, x, y, yaw):
    truth = walk(seed)
    estimate = shaken(truth, seed)
    moved = Trajectory(estimate.stamps_ns, compose(np.array([x, y, yaw]), estimate.poses))
    relations = relations_of(truth, seed)
    for here, there in (
        (score_trajectory("a", estimate, truth), score_trajectory("b", moved, truth)),
        (score_relations("a", estimate, relations), score_relations("b", moved, relations)),
    ):
        np.testing.assert_allclose(list(here.values.values()), list(there.values.values()), atol=1e-7)


@given(SEEDS, st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1))
def test_alignment_finds_the_motion(seed, x, y, yaw):
    points = walk(seed).poses
    found = align(points[:, :2], compose(np.array([x, y, yaw]), points)[:, :2])
    np.testing.assert_allclose(found, [x, y, yaw], atol=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_agrees_with_evo(seed):
    metrics = pytest.importorskip("evo.core.metrics")
    from evo.core.trajectory import PoseTrajectory3D

    truth = walk(seed)
    estimate = shaken(truth, seed)

    def in_space(trajectory):
        half = trajectory.poses[:, 2] / 2.0
        quaternions = np.column_stack([np.cos(half), 0 * half, 0 * half, np.sin(half)])
        points = np.column_stack([trajectory.poses[:, :2], 0 * half])
        return PoseTrajectory3D(points, quaternions, trajectory.stamps_ns * 1e-9)

    ref, est = in_space(truth), in_space(estimate)
    est.align(ref, correct_scale=False)
    mine = score_trajectory("mine", estimate, truth).values
    part, angle = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg
    theirs = {}
    ape = metrics.APE(part)
    ape.process_data((ref, est))
    for word in ("rmse", "mean", "median", "max"):
        theirs[f"ate_{word}_m"] = ape.get_all_statistics()[word]
    for label, delta, unit in (("step", 1, metrics.Unit.frames), ("1m", 1.0, metrics.Unit.meters)):
        for kind, relation in (("translation_rmse_m", part), ("rotation_rmse_deg", angle)):
            rpe = metrics.RPE(relation, delta, unit, pairs_from_reference=True)
            rpe.process_data((ref, est))
            theirs[f"rpe_{label}_{kind}"] = rpe.get_all_statistics()["rmse"]
    for name, value in theirs.items():
        assert mine[name] == pytest.approx(value, abs=1e-6), name


def test_missing_poses_lose_the_row():
    truth = walk(1)
    poses = truth.poses.copy()
    poses[40:60] = np.nan
    score = score_trajectory("gap", Trajectory(truth.stamps_ns, poses), truth)
    assert score.coverage == pytest.approx(100 / 120, abs=0.02)
    assert not score.is_complete
    relations = score_relations("gap", Trajectory(truth.stamps_ns, poses), relations_of(truth, 2))
    assert relations.coverage < 0.9
    assert np.isfinite(relations.values["translation_mean_m"])


def test_nothing_in_common_is_not_good():
    truth = walk(1)
    later = Trajectory(truth.stamps_ns + 10**15, truth.poses)
    score = score_trajectory("later", later, truth)
    assert score.coverage == 0.0
    assert np.isnan(score.values["ate_rmse_m"])


def test_a_slower_sensor_loses_nothing():
    truth = walk(3)
    slow = Trajectory(truth.stamps_ns[::4], truth.poses[::4])
    est, ref, coverage = associate(slow, truth)
    assert coverage == 1.0
    np.testing.assert_array_equal(est, ref)


@given(
    st.lists(st.integers(0, 1000), min_size=1, max_size=30), st.lists(st.integers(-100, 1100), max_size=30)
)
def test_nearest_stamp_matches_a_plain_search(stamps, times):
    stamps_ns = np.sort(np.array(stamps, dtype=np.int64)) * 1_000_000
    at_ns = np.array(times, dtype=np.int64) * 1_000_000
    for index, time in zip(nearest_stamp(stamps_ns, at_ns, 0.01), at_ns, strict=True):
        distance = np.abs(stamps_ns - time).min()
        assert (index == -1) == (distance > 10_000_000)
        assert index == -1 or abs(stamps_ns[index] - time) == distance


def test_a_relation_error_is_what_must_be_added_to_the_given_pose():
    trajectory = Trajectory(np.array([0, 10**9]), np.array([[1.0, 2.0, np.pi / 2], [1.0, 3.5, np.pi / 2]]))
    relations = Relations(np.array([0]), np.array([10**9]), np.array([[1.0, 0.0, 0.1]]))
    error = relation_errors(trajectory, relations)[0]
    np.testing.assert_allclose(compose(relations.poses[0], error), [1.5, 0.0, 0.0], atol=1e-12)


def test_relations_file(tmp_path):
    path = tmp_path / "x.relations"
    path.write_text("# t1 t2 ...\n976052905.167303 976052911.885496 -0.05 -0.12 0 0 0 -1.68\n\n")
    relations = read_relations(path)
    assert relations.first_ns.tolist() == [976052905167303000]
    assert relations.poses.tolist() == [[-0.05, -0.12, -1.68]]
    path.write_text("1 2 3\n")
    with pytest.raises(ArtifactError, match=r"x\.relations:1"):
        read_relations(path)
    path.write_text("")
    with pytest.raises(ArtifactError, match="no relation"):
        read_relations(path)


def test_reference_table_with_scan_numbers(tmp_path):
    path = tmp_path / "x.ref.txt"
    path.write_text("# raw_scan_index raw_timestamp x y theta\n5 12.5 1.0 2.0 0.5 0 0 0\n")
    reference = read_reference(path)
    assert reference.stamps_ns.tolist() == [12_500_000_000]
    assert reference.poses.tolist() == [[1.0, 2.0, 0.5]]
