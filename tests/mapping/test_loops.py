"""Loops: what a fit of two local maps is allowed to say."""

import numpy as np

from dynmap_cli.mapping.local_maps import Fit
from dynmap_cli.mapping.loops import _without_weak_direction


def fit_on(normals_rad, points):
    """A fit whose points (n, 2) lie on lines with normals of these directions."""
    normals = np.column_stack([np.cos(normals_rad), np.sin(normals_rad)])
    lever = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    rows = np.column_stack([normals, lever])
    return Fit(np.zeros(3), rows.T @ rows, 0.01, 0.5, 0.5, 0.0)


def corridor(rng, turn_rad, *, noise_rad):
    """Points on both walls of a corridor, their normals known up to some noise."""
    along = rng.uniform(-8.0, 8.0, 400)
    across = np.where(rng.random(400) < 0.5, 1.1, -1.1)
    points = np.column_stack(
        [
            along * np.cos(turn_rad) - across * np.sin(turn_rad),
            along * np.sin(turn_rad) + across * np.cos(turn_rad),
        ]
    )
    return fit_on(turn_rad + np.pi / 2.0 + rng.normal(0.0, noise_rad, 400), points)


def test_a_fit_in_a_bare_corridor_says_nothing_of_the_way_along_it():
    rng = np.random.default_rng(1)
    for turn_rad in (0.0, 0.2, 1.1, 2.5):
        fit = corridor(rng, turn_rad, noise_rad=np.radians(5.0))
        kept = _without_weak_direction(fit)
        along = np.array([np.cos(turn_rad), np.sin(turn_rad)])
        across = np.array([-along[1], along[0]])
        before = fit.information[:2, :2]
        after = kept.information[:2, :2]
        assert along @ before @ along > 1.0
        assert along @ after @ along < 0.2
        assert across @ after @ across > 0.99 * (across @ before @ across)
        assert kept.information[2, 2] == fit.information[2, 2]


def test_a_fit_that_knows_both_directions_is_kept_as_it_is():
    rng = np.random.default_rng(2)
    points = rng.uniform(-3.0, 3.0, (400, 2))
    fit = fit_on(np.where(rng.random(400) < 0.2, 0.0, np.pi / 2.0), points)
    assert _without_weak_direction(fit) is fit
