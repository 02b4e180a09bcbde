"""A filter that jumped away and came back."""

import numpy as np
import pytest

from dynmap_cli.localization.afterwards.bridges import Way, bridged

TRUE = np.column_stack([0.1 * np.arange(30), np.zeros(30), np.zeros(30)])
JUMPS = [9, 14]


def way(measured=True, scale=1.0):
    return Way(TRUE * [scale, 1.0, 1.0] + [3.0, 2.0, 0.0], np.full(29, measured))


def jumped():
    poses = TRUE.copy()
    poses[10:15] += [7.0, 3.0, 1.0]
    return poses


def cost_of(elsewhere):
    """Scans cost 1 where the robot is and *elsewhere* where it is not."""
    return lambda node, pose: 1.0 if np.hypot(*(pose - TRUE[node])[:2]) < 0.3 else elsewhere


@pytest.mark.parametrize("scale", [1.0, 1.1])
def test_the_robot_was_never_elsewhere_if_the_motion_leads_to_where_it_is_found_again(scale):
    found = bridged(jumped(), JUMPS, way(scale=scale), cost_of(0.5), jump_cost=10.0)
    np.testing.assert_allclose(found, TRUE, atol=0.05)
    np.testing.assert_array_equal(found[:10], TRUE[:10])


def test_a_place_that_fits_so_much_better_that_two_jumps_are_cheaper_is_kept():
    found = bridged(jumped(), JUMPS, way(), cost_of(-30.0), jump_cost=10.0)
    np.testing.assert_array_equal(found, jumped())


@pytest.mark.parametrize("broken", [way(measured=False), way(scale=4.0)])
def test_without_odometry_that_agrees_there_is_no_bridge(broken):
    np.testing.assert_array_equal(bridged(jumped(), JUMPS, broken, cost_of(0.5), 10.0), jumped())


def test_several_wrong_places_in_a_row_are_left_out_together():
    poses = jumped()
    poses[12:15] += [-20.0, 5.0, 0.5]
    found = bridged(poses, [9, 11, 14], way(), cost_of(0.5), jump_cost=10.0)
    np.testing.assert_allclose(found, TRUE, atol=0.05)
