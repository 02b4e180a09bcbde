"""Local maps: laying them over one another, and the cells that vary."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynmap_cli.clustering.local_maps import (
    LocalMaps,
    align,
    component_sizes,
    shifted,
    varying_vectors,
    without_specks,
)
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN

SHAPE = (30, 40)


def room(door_closed):
    """A wall with a gap of 14 cells that is closed or free."""
    states = np.full(SHAPE, UNKNOWN, dtype=np.int8)
    states[10, 3:36] = OCCUPIED
    states[4:20, 3] = OCCUPIED
    states[10, 12:26] = OCCUPIED if door_closed else FREE
    return states


def maps_of(*states):
    table = np.stack(states)
    values = np.where(table == UNKNOWN, np.nan, table).astype(np.float32)
    return LocalMaps(table, values, np.zeros(len(states), dtype=bool))


@given(st.integers(-2, 2), st.integers(-2, 2))
def test_shifting_back_restores_what_stayed_inside(rows, cols):
    grid = np.zeros(SHAPE)
    grid[5:20, 5:30] = np.random.default_rng(1).random((15, 25))
    there = shifted(grid, (rows, cols), 0.0)
    np.testing.assert_array_equal(shifted(there, (-rows, -cols), 0.0), grid)
    assert there[5 + rows, 5 + cols] == grid[5, 5]


@settings(max_examples=12)
@given(st.integers(-2, 2), st.integers(-2, 2))
def test_a_shifted_map_is_laid_over_the_others(rows, cols):
    straight = [room(k % 2 == 0) for k in range(6)]
    moved = shifted(room(True), (rows, cols), UNKNOWN)
    aligned = align(maps_of(*straight, moved))
    np.testing.assert_array_equal(aligned.states[-1][4:24, 3:34], room(True)[4:24, 3:34])


def test_a_change_is_no_reason_to_move():
    maps = maps_of(room(True), *[room(False)] * 5)
    np.testing.assert_array_equal(align(maps).states, maps.states)


def everywhere():
    return np.ones(SHAPE, dtype=bool)


def test_the_cells_of_a_door_vary():
    maps = maps_of(*[room(True)] * 3, *[room(False)] * 3)
    vectors = varying_vectors(maps, everywhere(), everywhere(), 6)
    assert vectors.values.shape == (6, 14)
    assert vectors.n_components == 1
    np.testing.assert_array_equal(vectors.values.mean(axis=1), [1, 1, 1, 0, 0, 0])


def test_a_rare_state_counts_on_few_maps_and_needs_two_on_many():
    few = maps_of(room(True), *[room(False)] * 9)
    many = maps_of(room(True), *[room(False)] * 19)
    assert varying_vectors(few, everywhere(), everywhere(), 6).values.shape[1] == 14
    assert varying_vectors(many, everywhere(), everywhere(), 6).values.shape[1] == 0


def test_cells_of_other_submaps_small_groups_and_uncontested_places_are_left_out():
    maps = maps_of(*[room(True)] * 3, *[room(False)] * 3)
    nowhere = np.zeros(SHAPE, dtype=bool)
    assert varying_vectors(maps, nowhere, everywhere(), 6).values.shape[1] == 0
    assert varying_vectors(maps, everywhere(), nowhere, 6).values.shape[1] == 0
    assert varying_vectors(maps, everywhere(), everywhere(), 15).values.shape[1] == 0


def test_mixed_maps_do_not_say_what_varies():
    maps = maps_of(room(True), *[room(False)] * 3)
    mixed = LocalMaps(maps.states, maps.reflectance, np.array([True, False, False, False]))
    assert varying_vectors(mixed, everywhere(), everywhere(), 6).values.shape == (4, 0)


def test_cells_one_apart_are_one_group():
    cells = np.zeros(SHAPE, dtype=bool)
    cells[2, [2, 4, 6]] = True
    cells[9, 9] = True
    assert sorted(component_sizes(cells)) == [1, 3]


def test_specks_are_taken_out_and_surfaces_stay():
    states = room(True)
    states[25, 20:23] = OCCUPIED
    clean = without_specks(states, 6)
    assert (clean[25, 20:23] == UNKNOWN).all()
    np.testing.assert_array_equal(clean[:24], states[:24])


def test_noise_of_single_maps_does_not_vary():
    draw = np.random.default_rng(2)
    noisy = [room(False) for _ in range(8)]
    for states in noisy:
        states[10, draw.choice(np.arange(13, 25), size=2, replace=False)] = OCCUPIED
    assert varying_vectors(maps_of(*noisy), everywhere(), everywhere(), 6).values.shape[1] == 0


def test_a_map_of_a_rare_state_is_laid_over_the_others_of_that_state():
    def with_box(states):
        states[18:26, [20, 30]] = OCCUPIED
        return states

    def no_wall_across(closed):
        states = room(closed)
        states[4:20, 3] = UNKNOWN
        return states

    boxes = [with_box(no_wall_across(False)) for _ in range(3)]
    moved = shifted(with_box(no_wall_across(False)), (0, 1), UNKNOWN)
    aligned = align(maps_of(*[no_wall_across(False)] * 30, *boxes, moved))
    np.testing.assert_array_equal(aligned.states[-1][:, 5:35], boxes[0][:, 5:35])


def test_a_rare_state_varies_also_where_only_one_of_its_maps_saw_it():
    def without_the_right(states):
        states[:, 20:] = UNKNOWN
        return states

    partial = [without_the_right(room(closed)) for closed in [True] + [False] * 8]
    vectors = varying_vectors(
        maps_of(room(True), *partial, *[room(False)] * 7), everywhere(), everywhere(), 6
    )
    np.testing.assert_array_equal(np.flatnonzero(vectors.cells[10]), np.arange(12, 26))
