"""Looks and watches: which scans they take in, and what they count."""

import numpy as np
import pytest

from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.counting.looks import count_watches, time_windows
from tests.counting.scenes import THING_M, scene, standing

LOOK_S = 5.0


def counted(log, watch_s):
    poses = log.odometry.copy()
    frame = frame_of_scans(log, poses, 30.0, 0.05)
    return count_watches(log, poses, frame, LOOK_S, watch_s, EvidenceParams())


def test_looks_are_counted_once_per_window():
    log = scene(standing(10, 20))
    poses = log.odometry.copy()
    frame = frame_of_scans(log, poses, 30.0, 0.05)
    looks = count_watches(log, poses, frame, LOOK_S, 0.0, EvidenceParams()).looks
    assert looks.n_looks == len(time_windows(log, LOOK_S)) == 12
    assert (looks.occupied + looks.free <= 12).all()
    distance_m = np.linalg.norm(looks.surface.frame.to_points(looks.surface.cells) - [THING_M, 0.0], axis=1)
    nearest = distance_m.argmin()
    assert (looks.occupied[nearest], looks.free[nearest]) == (2, 10)


def test_watches_overlap_by_half_and_take_in_every_scan():
    watches = counted(scene(standing(10, 20)), 20.0).watches
    assert [(watch.scans.start, watch.scans.stop) for watch in watches] == [
        (0, 200),
        (100, 300),
        (200, 400),
        (300, 500),
        (400, 600),
    ]


@pytest.mark.parametrize("watch_s", [10.0, 20.0, 120.0, 1000.0])
def test_every_look_is_in_one_or_two_watches(watch_s):
    watched = counted(scene(standing(10, 20)), watch_s)
    for name in ("occupied", "free"):
        total = getattr(watched.looks, name)
        in_watches = np.sum([getattr(watch, name) for watch in watched.watches], axis=0)
        assert (total <= in_watches).all()
        assert (in_watches <= 2 * total).all()


def test_a_watch_does_not_reach_over_a_pause():
    watches = counted(scene(standing(10, 20), pause_s=600.0), 100.0).watches
    assert [(watch.scans.start, watch.scans.stop) for watch in watches] == [(0, 300), (300, 600)]


def test_without_watches_all_looks_are_counted():
    log = scene(standing(10, 20))
    without, watched = counted(log, 0.0), counted(log, 20.0)
    assert without.watches == ()
    np.testing.assert_array_equal(without.looks.occupied, watched.looks.occupied)
    np.testing.assert_array_equal(without.hits, watched.hits)
    np.testing.assert_array_equal(without.crossed, watched.crossed)
