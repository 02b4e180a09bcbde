"""Laws of what has a belief of its own: objects together until visits show them free of one another."""

import math

import numpy as np
import pytest
from scipy import ndimage

from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import (
    NEVER_MAPPED,
    OFF,
    ON,
    UNKNOWN_STATE,
    ChangingObject,
    Patch,
    PatchSet,
    Visit,
)
from dynmap_cli.localization.beliefs.combinations import (
    MAX_COMBINATIONS,
    is_compatible,
    on_in_patches,
    possible_combinations,
    switches_of,
)
from dynmap_cli.localization.beliefs.parts import independent_parts, nearest_object, whole_parts
from dynmap_cli.localization.beliefs.state_tables import object_beliefs, patch_beliefs
from dynmap_cli.localization.beliefs.states import place_sweep, state_evidence, update_belief
from dynmap_cli.localization.found import StateRow
from dynmap_cli.localization.sensing.map_pool import BESIDE_CELLS, make_map_pool, slices_of
from dynmap_cli.localization.sensing.sensor import Sweep
from dynmap_cli.localization.settings import LocalizationSettings

FRAME = GridFrame(0.05, -1.0, -1.0, 80, 80)
LEFT, RIGHT = (slice(30, 34), slice(20, 28)), (slice(30, 34), slice(45, 53))
ALL = ((OFF, OFF), (OFF, ON), (ON, OFF), (ON, ON))
IN_TURN = ALL[:3]


def sub_map(combinations=ALL, times=3):
    """Two boxes 1 m apart in a sub-map of 20 x 50 cells; each combination is a patch and was seen so many times."""
    frame = FRAME.window(25, 15, 20, 50)
    boxes = np.zeros((2, *FRAME.shape), dtype=bool)
    boxes[0][LEFT], boxes[1][RIGHT] = True, True
    boxes = boxes[:, 25:45, 15:65]
    patches = []
    for number, states in enumerate(combinations):
        values = np.full(frame.shape, 0.02, np.float32)
        for box, state in zip(boxes, states, strict=True):
            if state == ON:
                values[box] = 0.7
            elif state == UNKNOWN_STATE:
                values[box] = np.nan
        patches.append(Patch(number, times, values))
    objects = tuple(
        ChangingObject(
            10 + number,
            box,
            {k: combinations[k % len(combinations)][number] for k in range(times * len(combinations))},
        )
        for number, box in enumerate(boxes)
    )
    return PatchSet(5, frame, boxes.any(axis=0), tuple(patches), math.exp(-0.2), objects=objects)


def visits_of(whole, every_s=60):
    count, n_patches = len(whole.objects[0].states), len(whole.patches)
    return [
        Visit(5, k, "log", k * every_s * 10**9, (k * every_s + 9) * 10**9, k % n_patches, 1.0)
        for k in range(count)
    ]


def parts_of(whole):
    return independent_parts([whole], visits_of(whole))


def pool_of(parts, occupied=None):
    cells = np.full(FRAME.shape, FREE, dtype=np.int8)
    if occupied is not None:
        cells[slices_of(parts[0].states.frame, FRAME)][occupied] = OCCUPIED
    return make_map_pool(OccupancyGrid(FRAME, cells), [part.states for part in parts], LocalizationSettings())


def row_of(stamp_ns, number, belief, in_view=(True, True)):
    return StateRow(stamp_ns, number, np.array(belief), np.array(in_view))


def placed(ranges_to_left_box=True):
    """Beams over both boxes; the left one is there, or nothing is."""
    bearings = np.radians(np.arange(30.0, 151.0))
    x = 0.8 + 1.02 / np.tan(bearings)
    hits = (x > 0.0) & (x < 0.4) & ranges_to_left_box
    ranges = np.where(hits, 1.02 / np.sin(bearings), 5.0)
    return place_sweep(Sweep(np.zeros(2), bearings, ranges, 6.0), np.array([0.8, -0.5, 0.0]))


def test_objects_seen_in_all_combinations_come_apart_and_others_stay_together():
    assert [len(part.states.objects) for part in parts_of(sub_map())] == [1, 1]
    (together,) = parts_of(sub_map(IN_TURN))
    assert len(together.states.objects) == 2
    in_step = sub_map((*[(OFF, OFF)] * 6, *[(ON, ON)] * 6, (OFF, ON), (ON, OFF)), times=1)
    assert len(parts_of(in_step)) == 1


def test_a_sub_map_of_one_part_keeps_its_patches_and_takes_what_was_never_mapped():
    whole = sub_map(IN_TURN)
    (part,) = parts_of(whole)
    assert part.states.patches[:3] == whole.patches
    (never,) = part.states.patches[3:]
    assert (never.patch_id, never.support) == (3, 0)
    assert on_in_patches(part.states).tolist() == [[0, 0], [0, 1], [1, 0], [1, 1]]
    np.testing.assert_array_equal(part.shown, [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]])
    pool = pool_of([part])
    assert pool.submaps[0].drawn[3] == pytest.approx(1 / 11)
    np.testing.assert_allclose(pool.submaps[0].drawn[:3], 10 / 33)


def test_every_known_cell_belongs_to_the_nearest_object():
    whole = sub_map()
    parts = parts_of(whole)
    owned = np.zeros(whole.frame.shape, dtype=int)
    for number, part in enumerate(parts):
        known = np.isfinite(part.states.patches[0].reflectance)
        frame = part.states.frame
        row = round((frame.origin_y_m - whole.frame.origin_y_m) / frame.resolution_m)
        col = round((frame.origin_x_m - whole.frame.origin_x_m) / frame.resolution_m)
        owned[row : row + known.shape[0], col : col + known.shape[1]] += known
        assert (nearest_object(whole) == number).sum() == known.sum()
    assert (owned == 1).all()


def test_off_and_on_differ_in_the_cells_of_the_object_only():
    for part in parts_of(sub_map()):
        off, on = (patch.reflectance for patch in part.states.patches)
        known = np.isfinite(off)
        assert ((on != off)[known] == part.states.varying[known]).all()
        assert (off[part.states.varying] <= 0.1).all()
        assert (on[part.states.varying] >= 0.25).all()
        assert [patch.support for patch in part.states.patches] == [6, 6]


def test_what_goes_with_an_object_comes_with_it_where_it_was_never_mapped():
    """The leaf of an open door beside the left object, which is off then."""
    whole = sub_map(IN_TURN)
    leaf = np.zeros(whole.frame.shape, dtype=bool)
    leaf[15:19, 6:8] = True
    for patch in whole.patches[:2]:
        patch.reflectance[leaf] = 0.6
    (part,) = parts_of(whole)
    never = part.states.patches[3].reflectance
    assert (never[leaf] < 0.1).all()
    assert (never[whole.varying] >= 0.25).all()


def test_an_object_that_is_on_in_no_patch_is_solid_where_it_is_on():
    (part,) = parts_of(sub_map(((OFF, OFF), (ON, OFF))))
    on = on_in_patches(part.states)
    assert sorted(map(tuple, on.tolist())) == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert [patch.support for patch in part.states.patches] == [3, 3, 0, 0]


def test_a_sub_map_without_objects_stays_whole():
    whole = PatchSet(6, FRAME.window(0, 0, 3, 3), np.zeros((3, 3), bool), sub_map().patches[:0], 1.0)
    plain = PatchSet(7, whole.frame, whole.varying, (Patch(0, 1, np.zeros((3, 3), np.float32)),), 1.0)
    (part,), (alone,) = independent_parts([whole, plain], []), whole_parts([whole, plain])
    assert part.states is alone.states is plain


def test_combinations_begin_with_those_seen_and_are_all_there_of_five_objects():
    seen = np.array([[1, 0, 0, 0, 0], [np.nan, 0, 1, 0, 0], [0, 0, 0, 0, 0]], dtype=np.float64)
    found = possible_combinations(seen)
    assert found[:2].tolist() == [[0, 0, 0, 0, 0], [1, 0, 0, 0, 0]]
    assert len({tuple(row) for row in found.tolist()}) == len(found) == 32
    assert found[2].tolist() == [0, 0, 1, 0, 0]
    many = possible_combinations(np.eye(12))
    assert len(many) == MAX_COMBINATIONS
    assert possible_combinations(np.full((0, 1), np.nan)).tolist() in ([[0], [1]], [[1], [0]])


def test_unknown_objects_fit_both_states_and_switch_with_none():
    unknown = np.array([[np.nan, 1.0]])
    assert is_compatible(np.array([[0.0, 1.0], [1.0, 0.0]]), unknown).tolist() == [[True], [False]]
    switches = switches_of(np.array([[0, 1], [1, 1], [np.nan, 1], [1, 0]], dtype=np.float64))
    assert switches.tolist() == [[0, 1, 0], [1, 1, 3]]


def test_posterior_of_independent_parts_is_the_product_of_their_posteriors():
    """One scan that sees both boxes: two beliefs say what one belief over all four combinations says."""
    settings, whole = LocalizationSettings(), sub_map()
    beliefs = {}
    for name, parts in (("whole", whole_parts([whole])), ("apart", parts_of(whole))):
        pool = pool_of(parts)
        rows = []
        for number, submap in enumerate(pool.submaps):
            evidence = state_evidence(placed(), pool, submap, settings)
            assert evidence.objects_in_view.all()
            alike = np.full(submap.n_states, 1 / submap.n_states)
            belief = update_belief(alike, 0.05 * evidence.log_likelihoods)
            rows.append(StateRow(0, number, belief, evidence.objects_in_view))
        on = {row.object_id - 10: row.probability_on for row in object_beliefs(rows, parts)}
        (row,) = patch_beliefs(rows, pool, parts, [whole])
        beliefs[name] = row.belief[:4]
        product = [
            math.prod(on[k] if state == ON else 1 - on[k] for k, state in enumerate(states)) for states in ALL
        ]
        np.testing.assert_allclose(row.belief[:4], product, atol=0.02 if name == "whole" else 1e-9)
    assert beliefs["apart"].argmax() == 2
    np.testing.assert_allclose(beliefs["apart"], beliefs["whole"], atol=0.05)


def test_beams_decide_against_what_was_mapped():
    """Of a box that was always in one of two places, beams show that it is in neither."""
    settings, whole = LocalizationSettings(), sub_map(((OFF, ON), (ON, OFF)), times=9)
    (part,) = parts_of(whole)
    pool = pool_of([part])
    belief = pool.submaps[0].drawn
    for _ in range(5):
        evidence = state_evidence(placed(ranges_to_left_box=False), pool, pool.submaps[0], settings)
        belief = update_belief(belief, 0.1 * evidence.log_likelihoods)
    (row,) = patch_beliefs([row_of(0, 0, belief)], pool, [part], [whole])
    assert row.patch_ids == (0, 1, NEVER_MAPPED)
    assert row.belief.argmax() == 2
    assert row.description == "0 without object 11"


def test_a_combination_never_mapped_has_a_probability_and_a_name():
    whole = sub_map(IN_TURN)
    parts = parts_of(whole)
    rows = [row_of(0, 0, [0.05, 0.05, 0.1, 0.8])]
    on = [row.probability_on for row in object_beliefs(rows, parts)]
    np.testing.assert_allclose(on, [0.9, 0.85])
    (row,) = patch_beliefs(rows, pool_of(parts), parts, [whole])
    np.testing.assert_allclose(row.belief, [0.05, 0.05, 0.1, 0.8])
    assert row.description == "1 with object 10"


def test_only_objects_in_view_have_a_row():
    whole = sub_map(IN_TURN)
    parts = parts_of(whole)
    rows = [row_of(0, 0, [0.1, 0.2, 0.3, 0.4], in_view=(False, True))]
    assert [row.object_id for row in object_beliefs(rows, parts)] == [11]


def test_a_part_out_of_view_counts_with_what_was_last_believed_and_forgets_it():
    whole = sub_map()
    parts = parts_of(whole)
    sure, soon, late = [0.0, 1.0], 10**9, 10**13
    rows = [row_of(0, 1, sure, [True]), *(row_of(stamp, 0, sure, [True]) for stamp in (soon, late))]
    found = patch_beliefs(rows, pool_of(parts), parts, [whole])
    assert [row.stamp_ns for row in found] == [0, soon, late]
    np.testing.assert_allclose(found[0].belief, [0, 0.5, 0, 0.5, 0], atol=1e-9)
    assert found[1].belief[3] > 0.95
    np.testing.assert_allclose(found[2].belief, [0, 0, 0.5, 0.5, 0], atol=1e-6)


def test_what_a_patch_does_not_know_is_no_other_state():
    """Behind a box that hides the other one, all states with it are that patch."""
    whole = sub_map(((OFF, OFF), (ON, UNKNOWN_STATE)))
    (part,) = parts_of(whole)
    on = on_in_patches(part.states)
    for state, shown in zip(on[2:].tolist(), part.shown[2:].tolist(), strict=True):
        assert shown == ([0.0, 1.0] if state[0] == 1.0 else [0.0, 0.0])
    assert part.on_probabilities[1].tolist() == [1.0, 0.5]


def test_what_no_state_changes_is_left_to_the_map():
    whole = sub_map(IN_TURN)
    wall = np.zeros(whole.frame.shape, dtype=bool)
    wall[0] = True
    for patch in whole.patches:
        patch.reflectance[wall] = 0.9
    around = np.ones((3, 3), dtype=bool)
    (submap,) = pool_of(parts_of(whole), wall).submaps
    np.testing.assert_array_equal(submap.owned, ndimage.binary_dilation(whole.varying, around, BESIDE_CELLS))
    (submap,) = pool_of(parts_of(whole)).submaps
    lacking = ndimage.binary_dilation(whole.varying | wall, around, BESIDE_CELLS)
    np.testing.assert_array_equal(submap.owned, lacking)
    one_state = PatchSet(5, whole.frame, whole.varying, whole.patches[:1], 1.0)
    assert pool_of(whole_parts([one_state])).submaps[0].owned.all()
