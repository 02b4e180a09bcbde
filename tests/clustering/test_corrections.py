"""States merged by hand: visits together, the mean weighted by support."""

import numpy as np

from dynmap_cli.clustering.corrections import apply_corrections, merge_states
from dynmap_cli.domain.corrections import Drop, Merge, Place
from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import Patch, PatchSet, Visit, cells_that_vary
from dynmap_cli.domain.staying import stay_probability
from dynmap_cli.domain.submaps import SubMap

FRAME = GridFrame(0.05, 1.0, 2.0, 2, 3)
MASK = np.ones(FRAME.shape, dtype=bool)
SUBMAP = SubMap(5, FRAME, 0, 0, MASK, MASK, 0.015)
S = 10**9


def patch(number, support, *values):
    return Patch(number, support, np.array(values, dtype=np.float32).reshape(FRAME.shape))


def patch_set():
    nan = np.nan
    patches = (
        patch(0, 3, 0.0, 0.4, nan, nan, 0.0, 1.0),
        patch(1, 2, 0.9, 0.0, 0.0, 0.0, 0.0, 0.0),
        patch(4, 1, 0.8, 0.0, 0.5, nan, 0.0, 0.6),
    )
    return PatchSet(5, FRAME, cells_that_vary(patches), patches, 0.5, (1.0, 2.0))


def visits():
    states = [0, 4, 1, None, 0, 1, 0]
    own = [Visit(5, k, "log", 60 * k * S, (60 * k + 5) * S, state, 0.9) for k, state in enumerate(states)]
    return [*own, Visit(6, 0, "log", 0, S, 4, 0.9)]


def test_two_states_become_one():
    (zero, one), seen = merged()
    assert (zero.patch_id, zero.support, one.patch_id, one.support) == (0, 4, 1, 2)
    expected = [0.2, 0.3, 0.5, np.nan, 0.0, 0.9]
    assert np.allclose(zero.reflectance.ravel(), expected, equal_nan=True)
    assert [visit.patch for visit in seen] == [0, 0, 1, None, 0, 1, 0, 4]
    assert [visit.membership for visit in seen] == [0.9] * 8


def merged():
    made, seen = merge_states(patch_set(), visits(), (4, 0))
    assert np.array_equal(made.varying, cells_that_vary(made.patches))
    assert made.stay_probability == stay_probability([visit for visit in seen if visit.submap_id == 5], 2)
    return made.patches, seen


def test_corrections_are_applied_in_order_and_those_of_sub_maps_passed_over():
    place = Place(5, SUBMAP.rectangle)
    said = (Drop(place), Merge(place, (1, 4)), Merge(place, (0, 1)))
    (made,), seen, lines = apply_corrections([patch_set()], visits(), [SUBMAP], said)
    assert [(patch.patch_id, patch.support) for patch in made.patches] == [(0, 6)]
    assert made.stay_probability == 1.0
    assert not made.varying.any()
    assert lines == [
        "correction 2: sub-map 5: states 1, 4 are one",
        "correction 3: sub-map 5: states 0, 1 are one",
    ]
    assert {visit.patch for visit in seen if visit.submap_id == 5} == {0, None}


def test_a_state_that_is_not_there_any_more_is_said():
    said = (Merge(Place(5, SUBMAP.rectangle), (0, 2)), Merge(Place(5, SUBMAP.rectangle), (0, 2, 4)))
    (made,), _, lines = apply_corrections([patch_set()], visits(), [SUBMAP], said)
    assert [patch.patch_id for patch in made.patches] == [0, 1]
    assert all(line.startswith("warning: ") and "no 2 any more" in line for line in lines)
