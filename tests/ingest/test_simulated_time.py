"""Recordings on the clock of a simulation, which begins at zero, and again where the simulation is started anew."""

from dataclasses import dataclass

import numpy as np
import pytest

from dynmap_cli.domain.poses import between
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import (
    ODOMETRY,
    PERIOD_NS,
    SCAN,
    START_NS,
    TF,
    odometry,
    scan,
    transform,
)


@dataclass
class Simulated(Room):
    """A room that is driven through from its start again; odometry begins at its origin each time.

    The laser begins some scans later. Times of recording are those of the simulation, or of the computer it runs on.
    """

    lengths: tuple[int, ...] = (120,)
    first: int = 0
    is_logged_in_simulation: bool = False
    is_put_back: bool = True

    @property
    def starts(self):
        return np.concatenate([[0], np.cumsum(self.lengths)[:-1]]) * (not self.is_put_back)

    def messages(self):
        rng = np.random.default_rng(11)
        values = self.mounting
        yield "/tf_static", TF, 0, {"transforms": [transform("base_link", "laser", 0, values)]}
        logged_ns = START_NS
        for start, length in zip(self.starts.tolist(), self.lengths, strict=True):
            rows = slice(start, start + length)
            poses = between(np.broadcast_to(self.poses[start], (length, 3)), self.poses[rows])
            for number, ((x, y, yaw), ranges_m) in enumerate(zip(poses, self.ranges_m[rows], strict=True)):
                stamp_ns = number * PERIOD_NS
                logged_ns = stamp_ns if self.is_logged_in_simulation else logged_ns + PERIOD_NS
                where = (x, y, 0.0, 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
                yield "/odom", ODOMETRY, logged_ns, odometry("odom", "base_link", stamp_ns, where)
                if number >= max(self.first, 1):
                    noisy_m = ranges_m + rng.normal(0.0, 0.003, ranges_m.size).astype(np.float32)
                    yield "/scan", SCAN, logged_ns + 1000, scan(self, stamp_ns, noisy_m)


@pytest.mark.parametrize("lengths", [(120, 120), (120, 70), (70, 120), (50, 60, 70)])
@pytest.mark.parametrize("first", [0, 4])
@pytest.mark.parametrize("is_logged_in_simulation", [False, True])
def test_a_robot_that_is_put_back_to_its_start_has_the_poses_of_its_odometry(
    is_logged_in_simulation, first, lengths, tmp_path
):
    world = Simulated(lengths=lengths, first=first, is_logged_in_simulation=is_logged_in_simulation)
    log, report = read(tmp_path, world)
    assert any("the robot was put back to where it began" in line for line in report.warnings)
    assert not any("started anew while it was made" in line for line in report.warnings)
    expected = np.concatenate(
        [
            between(np.broadcast_to(world.poses[0], (length, 3)), world.poses[:length])[max(first, 1) :]
            for length in lengths
        ]
    )
    assert log.n_scans == expected.shape[0]
    np.testing.assert_allclose(log.odometry, expected, atol=1e-6)


@pytest.mark.parametrize("is_logged_in_simulation", [False, True])
def test_where_the_scans_go_on_the_odometry_goes_on_as_well(is_logged_in_simulation, tmp_path):
    world = Simulated(
        lengths=(60, 60), is_put_back=False, is_logged_in_simulation=is_logged_in_simulation, n_scans=120
    )
    log, report = read(tmp_path, world)
    assert not any("put back" in line for line in report.warnings)
    assert any("the odometry was started anew" in line for line in report.warnings)
    assert np.hypot(*np.diff(log.odometry[:, :2], axis=0).T).max() < 0.1


def test_a_simulation_that_begins_at_zero_is_read_without_a_word(tmp_path):
    world = Simulated(is_logged_in_simulation=True)
    log, report = read(tmp_path, world)
    assert not report.warnings
    assert log.n_scans == world.n_scans - 1
