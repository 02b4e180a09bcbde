"""A crowd is seen by the odometry alone, and does not carry the registration along."""

from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.evaluation.trajectories import score_trajectory
from dynmap_cli.mapping.first_guess import crowd_weights
from dynmap_cli.mapping.rounds import build_filter_map
from dynmap_cli.mapping.settings import MapSettings
from dynmap_cli.simulation import parse_scenario, simulate
from dynmap_cli.simulation.sensing import MOVING, STATIC

CROWD = [
    {"does": "stream", "path": [[-3, 5], [33, 5]], "width_m": 5, "count": 30, "speed_mps": 0.9},
    {"does": "accompany", "count": 6},
]


def concourse(movers, **changes):
    """A hall of 30 m with open ends, two bays and pillars; the robot goes there and back."""
    return simulate(
        parse_scenario(
            {
                "seed": 8,
                "world": {
                    "walls": [
                        [[0, 2], [0, 0], [10, 0], [10, -1.5], [13, -1.5], [13, 0], [30, 0], [30, 2]],
                        [[30, 8], [30, 10], [21, 10], [21, 11], [18, 11], [18, 10], [0, 10], [0, 8]],
                    ],
                    "legs": [
                        {"at": [x, y], "radius_m": 0.3} for x in (5, 10, 15, 20, 25) for y in (2.5, 8.5)
                    ],
                },
                "movers": movers,
                "robot": {"path": [[3, 4], [26, 4], [26, 7], [3, 6.5]], "speed_mps": 0.8},
                "lasers": [{"beams": 181, "fov_deg": 270, "max_range_m": 25, "rate_hz": 4, "sees": "torso"}],
                **changes,
            }
        )
    )


@pytest.fixture(scope="module")
def crowd():
    return concourse(CROWD)


def test_a_crowd_is_seen_by_the_odometry(crowd):
    weights = crowd_weights(crowd.log, 30.0, threads=1)
    moving, static = (crowd.beam_class == code for code in (MOVING, STATIC))
    assert moving.mean() > 1 / 3
    assert (weights[moving] < 0.5).mean() > 0.5
    near = static & (crowd.log.ranges_m <= 20.0)
    assert (weights[near] >= 0.5).mean() > 0.99
    np.testing.assert_array_equal(weights, crowd_weights(crowd.log, 30.0, threads=2))


def test_an_empty_hall_and_a_robot_without_odometry_have_no_crowd():
    assert crowd_weights(concourse([]).log, 30.0, threads=1) is None
    assert crowd_weights(concourse(CROWD, odometry=None).log, 30.0, threads=1) is None


def test_odometry_that_jumps_says_nothing_in_its_window(crowd):
    odometry = np.array(crowd.log.odometry)
    odometry[20:, 0] += 1e7
    jumped = crowd_weights(replace(crowd.log, odometry=odometry), 30.0, threads=1)
    weights = crowd_weights(crowd.log, 30.0, threads=1)
    # The jump is after 5 s, so the windows from 0 to 8 s and from 4 to 12 s say nothing.
    assert np.isnan(jumped[16:32]).all()
    assert ((jumped[48:] < 0.5) == (weights[48:] < 0.5)).mean() > 0.99


def test_a_crowd_does_not_carry_the_path_along(crowd):
    found = build_filter_map(crowd.log, MapSettings(), threads=1)
    truth = Trajectory(crowd.log.stamps_ns, crowd.true_poses)
    assert score_trajectory("", found.trajectory, truth).values["ate_rmse_m"] < 0.03
