"""The parts of placing a drive: the order in which places are tried, who agrees with whom, and pairs to join."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import compose
from dynmap_cli.mapping.placing import Places, _candidates, _spread_out, _Vote, near_pairs


@pytest.mark.parametrize("n", [0, 1, 2, 3, 7, 8, 41])
def test_each_place_is_tried_once(n):
    assert sorted(_spread_out(n)) == list(range(n))


def test_the_first_places_lie_far_apart():
    first = list(_spread_out(100))[:4]
    assert min(abs(a - b) for a in first for b in first if a != b) >= 15


def votes_for(pose, places, matched=0.8):
    return [_Vote(place, np.array(pose), matched) for place in places]


def test_votes_for_one_pose_win_over_scattered_ones():
    rng = np.random.default_rng(0)
    drive = Places([], np.column_stack([np.arange(30) * 1.5, np.zeros(30), np.zeros(30)]))
    votes = votes_for((3.0, -2.0, 0.5), range(0, 12, 3))
    votes += [_Vote(place, rng.uniform(-20, 20, 3), 0.9) for place in range(12, 20)]
    agreed, *others = _candidates(votes, drive)
    assert {vote.place for vote in agreed} == {0, 3, 6, 9}
    assert [len(other) for other in others] == [1] * 8


def test_two_halls_that_look_the_same_are_rivals():
    drive = Places([], np.column_stack([np.arange(30) * 0.5, np.zeros(30), np.zeros(30)]))
    votes = votes_for((0.0, 0.0, 0.0), range(5)) + votes_for((0.0, 10.0, 0.0), range(5))
    assert [len(agreed) for agreed in _candidates(votes, drive)] == [5, 5]


def test_a_bent_drive_is_allowed_more_the_farther_the_places_are_apart():
    drive = Places([], np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [60.0, 0.0, 0.0]]))
    bent = [_Vote(0, np.zeros(3), 0.8), _Vote(1, np.array([0.0, 0.9, 0.0]), 0.8)]
    assert len(_candidates(bent, drive)[0]) == 1
    bent[1] = _Vote(2, np.array([0.0, 0.9, 0.0]), 0.8)
    assert len(_candidates(bent, drive)[0]) == 2


def test_pairs_join_each_drive_to_earlier_ones_only():
    poses = np.array([[float(k), 0.0, 0.0] for k in range(10)] + [[float(k), 0.5, 0.0] for k in range(5, 25)])
    pairs = near_pairs(poses, np.array([0, 10]), 1.0, 3)
    assert len(pairs) == 3
    assert all(later >= 10 > earlier for later, earlier in pairs)
    assert all(np.hypot(*(poses[a] - poses[b])[:2]) <= 1.0 for a, b in pairs)
    assert near_pairs(compose(np.array([1.0, 2.0, 3.0]), poses), np.array([0, 10]), 1.0, 3) == pairs
