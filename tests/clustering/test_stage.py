"""From a simulated log to patches: doors, boxes, people."""

import numpy as np
import pytest

from dynmap_cli.clustering.learning import learn_patch_map
from dynmap_cli.clustering.local_maps import build_local_maps, varying_vectors
from dynmap_cli.clustering.sequences import SequenceParams
from dynmap_cli.clustering.settings import ClusteringSettings
from dynmap_cli.clustering.states import MIXED, StateParams, describe, label_visits
from dynmap_cli.counting.em import FilterParams
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.segmentation.finding import find_submaps
from dynmap_cli.segmentation.settings import SegmentationSettings
from tests.reference.clustering import plain_rand_index
from tests.segmentation.worlds import corridor, door, shifted_poses, two_doors

SETTINGS = ClusteringSettings()


def learn(run, frame, poses, threads=1):
    submaps, _ = find_submaps(run.log, poses, frame, SegmentationSettings())
    return submaps, *learn_patch_map(run.log, poses, submaps, SETTINGS, threads=threads)


def truth_of(run, visits, number):
    """State of an object in the middle of each visit."""
    middle = [np.searchsorted(run.log.stamps_ns, (v.start_ns + v.end_ns) // 2) for v in visits]
    return run.object_states[middle, number].tolist()


@pytest.fixture(scope="module")
def doors():
    return corridor(doors=two_doors())


@pytest.mark.parametrize(("sigma_m", "sigma_deg"), [(0.0, 0.0), (0.02, 0.2)])
def test_two_doors_have_two_states_each_and_every_visit_is_right(doors, sigma_m, sigma_deg):
    run, frame = doors
    submaps, patch_sets, visits = learn(run, frame, shifted_poses(run, sigma_m, sigma_deg))
    assert [len(patch_set.patches) for patch_set in patch_sets] == [2, 2]
    for number in (0, 1):
        known = [v for v in visits if v.submap_id == number and v.patch is not None]
        assert len(known) >= 9
        assert plain_rand_index(truth_of(run, known, number), [v.patch for v in known]) == 1.0
        patches = patch_sets[number].patches
        assert sum(patch.support for patch in patches) == len(known)
        assert patches[0].support >= patches[1].support
        closed = max(patches, key=lambda p: np.nansum(p.reflectance * patch_sets[number].varying))
        opened = min(patches, key=lambda p: np.nansum(p.reflectance * patch_sets[number].varying))
        assert np.nanmean(closed.reflectance[patch_sets[number].varying]) > 0.5
        assert np.nanmean(opened.reflectance[patch_sets[number].varying]) < 0.1
        assert patch_sets[number].frame == submaps[number].frame
        assert 0.5 < patch_sets[number].stay_probability < 0.8
    assert describe(patch_sets, visits)[0].startswith("sub-map 0: 2 states in ")


def test_any_number_of_threads_gives_the_same(doors):
    run, frame = doors
    _, one, visits_one = learn(run, frame, run.true_poses)
    _, two, visits_two = learn(run, frame, run.true_poses, threads=2)
    assert visits_one == visits_two
    for a, b in zip(one, two, strict=True):
        for p, q in zip(a.patches, b.patches, strict=True):
            np.testing.assert_array_equal(p.reflectance, q.reflectance)


def test_a_box_at_three_places_has_three_states():
    places = {"a": [2.2, 0.4, 10], "b": [5.5, 1.6, 30], "c": [8.7, 0.5, 0]}
    schedule = [[0, "a"], [31, "b"], [61, "c"], [92, "a"], [122, "b"], [152, "c"]]
    box = {"name": "box", "size_m": [0.4, 0.4], "absent": False, "places": places, "schedule": schedule}
    run, frame = corridor(boxes=[box])
    submaps, patch_sets, visits = learn(run, frame, run.true_poses)
    assert len(submaps) == 1
    assert len(patch_sets[0].patches) == 3
    known = [v for v in visits if v.patch is not None]
    assert plain_rand_index(truth_of(run, known, 0), [v.patch for v in known]) == 1.0


def test_a_door_that_moves_while_it_is_watched_makes_the_visit_mixed():
    run, _ = corridor(doors=[door("south", [3, 0], [4, 0], -90, [60])], repeat=3)
    rectangle = GridFrame(0.05, 2.8, -0.2, 8, 28)
    seconds = (run.log.stamps_ns - run.log.stamps_ns[0]) / 1e9
    spans = [(25, 40), (53, 67), (80, 95)]
    sequences = [np.flatnonzero((seconds > start) & (seconds < end)) for start, end in spans]
    maps = build_local_maps(
        run.log, run.true_poses, rectangle, sequences, EvidenceParams(), FilterParams(usable_range_m=12.0), 6
    )
    assert maps.is_mixed.tolist() == [False, True, False]
    params = StateParams(SequenceParams(), EvidenceParams(), FilterParams(), 0.3, 12, 6)
    everywhere = np.ones(rectangle.shape, dtype=bool)
    labels = label_visits(varying_vectors(maps, everywhere, everywhere, 6), maps.is_mixed, params)
    assert labels.remarks == ("", MIXED, "")
    assert labels.patch.tolist() == [0, -1, 1]


def test_no_submap_no_states(doors):
    run, _ = doors
    assert learn_patch_map(run.log, run.true_poses, (), SETTINGS) == ((), ())


def test_where_near_visits_show_one_state_those_from_farther_away_are_taken(doors):
    run, frame = doors
    submaps, _ = find_submaps(run.log, run.true_poses, frame, SegmentationSettings())
    beyond_reach = ClusteringSettings(near_m=0.3)
    patch_sets, visits = learn_patch_map(run.log, run.true_poses, submaps, beyond_reach)
    assert [len(patch_set.patches) for patch_set in patch_sets] == [2, 2]
    for number in (0, 1):
        known = [v for v in visits if v.submap_id == number and v.patch is not None]
        assert plain_rand_index(truth_of(run, known, number), [v.patch for v in known]) == 1.0
