"""Which local maps stand for a place."""

import numpy as np

from dynmap_cli.mapping.places import representatives


def laps(n, *, backwards=()):
    """Poses (64 n, 3) around a block of 32 m x 16 m with 1.5 m between them, a few centimetres beside each other."""
    rng = np.random.default_rng(n)
    way = np.arange(64) * 1.5
    corners, turns = (
        np.array([[0, 0], [32, 0], [32, 16], [0, 16], [0, 0]]),
        np.array([0.0, 0.5, 1.0, -0.5]) * np.pi,
    )
    lengths = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners, axis=0)).sum(axis=1))])
    lap = np.column_stack(
        [
            *(np.interp(way, lengths, corners[:, axis]) for axis in (0, 1)),
            turns[np.searchsorted(lengths[1:-1], way, side="right")],
        ]
    )
    turned = lap[::-1] + np.array([0.0, 0.0, np.pi])
    parts = [turned if number in backwards else lap for number in range(n)]
    return np.concatenate(parts) + rng.normal(0.0, 0.05, (64 * n, 3))


def test_all_maps_of_the_first_visit_stand_for_their_places():
    np.testing.assert_array_equal(representatives(laps(1)), np.arange(64))


def test_a_place_has_no_more_of_them_however_often_the_robot_comes():
    few, many = representatives(laps(10)), representatives(laps(60))
    assert many.size < 1.1 * few.size < 64 * 4
    np.testing.assert_array_equal(many[: few.size // 2], few[: few.size // 2])


def test_the_way_back_sees_something_else():
    forth, both = laps(12), laps(12, backwards=range(6, 12))
    assert (representatives(forth) >= 6 * 64).sum() < 20
    assert (representatives(both) >= 6 * 64).sum() > 60


def test_a_new_place_is_always_stood_for():
    poses = laps(8)
    poses[-5:, 0] += 100.0
    assert set(range(len(poses) - 5, len(poses))) <= set(representatives(poses).tolist())
