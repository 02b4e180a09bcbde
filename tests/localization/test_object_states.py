"""Laws of a belief per object."""

import math

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE, ChangingObject, Patch, PatchSet, Visit
from dynmap_cli.localization.found import StateRow
from dynmap_cli.localization.map_pool import make_map_pool
from dynmap_cli.localization.object_states import nearest_object, object_parts, on_probabilities, whole_parts
from dynmap_cli.localization.sensor import Sweep
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.state_tables import object_beliefs, patch_beliefs
from dynmap_cli.localization.states import place_sweep, state_evidence, update_belief

FRAME = GridFrame(0.05, -1.0, -1.0, 80, 80)
LEFT, RIGHT = (slice(30, 34), slice(20, 28)), (slice(30, 34), slice(45, 53))
ALL = ((OFF, OFF), (OFF, ON), (ON, OFF), (ON, ON))


def sub_map(combinations=ALL):
    """Two boxes 1 m apart in a sub-map of 20 x 50 cells, in as many visits as there are combinations."""
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
        patches.append(Patch(number, 3, values))
    objects = tuple(
        ChangingObject(number, box, {k: states[number] for k, states in enumerate(combinations)})
        for number, box in enumerate(boxes)
    )
    return PatchSet(5, frame, boxes.any(axis=0), tuple(patches), math.exp(-0.2), objects=objects)


def visits(count, every_s=60):
    return [
        Visit(5, k, "log", k * every_s * 10**9, (k * every_s + 9) * 10**9, None, 1.0) for k in range(count)
    ]


def pool_of(parts):
    cells = np.full(FRAME.shape, FREE, dtype=np.int8)
    return make_map_pool(OccupancyGrid(FRAME, cells), [part.states for part in parts], LocalizationSettings())


def test_every_known_cell_belongs_to_the_nearest_object():
    whole = sub_map()
    parts = object_parts([whole], visits(4))
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
    for part in object_parts([sub_map(ALL[1:])], visits(3)):
        off, on = (patch.reflectance for patch in part.states.patches)
        known = np.isfinite(off)
        assert ((on != off)[known] == part.states.varying[known]).all()
        assert (off[part.states.varying] <= 0.1).all()
        assert (on[part.states.varying] >= 0.25).all()


def test_an_object_that_is_on_in_no_patch_is_solid_where_it_is_on():
    left, right = object_parts([sub_map(((OFF, OFF), (ON, OFF)))], visits(2))
    assert [patch.support for patch in right.states.patches] == [2, 0]
    assert (right.states.patches[1].reflectance[right.states.varying] >= 0.25).all()
    assert left.states.stay_probability < right.states.stay_probability


def test_a_sub_map_without_objects_stays_whole():
    whole = PatchSet(6, FRAME.window(0, 0, 3, 3), np.zeros((3, 3), bool), sub_map().patches[:0], 1.0)
    plain = PatchSet(7, whole.frame, whole.varying, (Patch(0, 1, np.zeros((3, 3), np.float32)),), 1.0)
    assert object_parts([whole, plain], []) == whole_parts([whole, plain]) == whole_parts([plain])


def test_posterior_of_independent_objects_is_the_product_of_their_posteriors():
    """One scan that sees both boxes: two beliefs say what one belief over all four combinations says."""
    settings, whole = LocalizationSettings(), sub_map()
    bearings = np.radians(np.arange(30.0, 151.0))
    x = 0.8 + 1.02 / np.tan(bearings)
    hits = (x > 0.0) & (x < 0.4)
    ranges = np.where(hits, 1.02 / np.sin(bearings), 5.0)
    placed = place_sweep(Sweep(np.zeros(2), bearings, ranges, 6.0), np.array([0.8, -0.5, 0.0]))
    beliefs = {}
    for name, parts in (("whole", whole_parts([whole])), ("objects", object_parts([whole], visits(4)))):
        pool = pool_of(parts)
        rows = []
        for number, submap in enumerate(pool.submaps):
            evidence = state_evidence(placed, pool, submap, settings)
            alike = np.full(submap.n_states, 1 / submap.n_states)
            rows.append(StateRow(0, number, update_belief(alike, 0.05 * evidence.log_likelihoods)))
        on = {row.object_id: row.probability_on for row in object_beliefs(rows, parts)}
        (row,) = patch_beliefs(rows, pool, parts, [whole])
        beliefs[name] = row.belief
        product = [
            math.prod(on[k] if state == ON else 1 - on[k] for k, state in enumerate(states)) for states in ALL
        ]
        np.testing.assert_allclose(row.belief, product, atol=0.02 if name == "whole" else 1e-9)
    assert beliefs["objects"].argmax() == 2
    np.testing.assert_allclose(beliefs["objects"], beliefs["whole"], atol=0.05)


def test_a_combination_never_mapped_is_believed_of_the_objects_only():
    whole = sub_map(ALL[:3])
    parts = object_parts([whole], visits(3))
    rows = [StateRow(0, k, np.array([0.1, 0.9])) for k in range(2)]
    assert [row.probability_on for row in object_beliefs(rows, parts)] == [0.9, 0.9]
    (row,) = patch_beliefs(rows, pool_of(parts), parts, [whole])
    np.testing.assert_allclose(row.belief, np.array([0.01, 0.09, 0.09]) / 0.19)


def test_an_object_out_of_view_counts_with_what_was_last_believed_and_forgets_it():
    whole = sub_map()
    parts = object_parts([whole], visits(4))
    sure, soon, late = np.array([0.0, 1.0]), 10**9, 10**13
    rows = [StateRow(0, 1, sure), *(StateRow(stamp, 0, sure) for stamp in (soon, late))]
    found = patch_beliefs(rows, pool_of(parts), parts, [whole])
    assert [row.stamp_ns for row in found] == [0, soon, late]
    np.testing.assert_allclose(found[0].belief, [0, 0.5, 0, 0.5], atol=1e-9)
    assert found[1].belief[3] > 0.98
    np.testing.assert_allclose(found[2].belief, [0, 0, 0.5, 0.5], atol=1e-6)


@pytest.mark.parametrize("states", [(OFF, ON), (ON, UNKNOWN_STATE)])
def test_a_patch_that_knows_nothing_of_an_object_says_nothing_of_it(states):
    whole = sub_map((states,))
    expected = [{OFF: 0.0, ON: 1.0, UNKNOWN_STATE: 0.5}[state] for state in states]
    assert [on_probabilities(thing, whole.patches)[0] for thing in whole.objects] == expected
