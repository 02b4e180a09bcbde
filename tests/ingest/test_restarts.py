"""An odometry that starts at its origin again while a recording is made."""

import numpy as np
import pytest

from dynmap_cli.domain.poses import between
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read


class Restarted(Room):
    """A room in which the odometry is started anew before some scans."""

    restarts = (60,)
    is_exact = True

    @property
    def poses(self):
        poses = super().poses.copy()
        whole = poses.copy()
        for first in self.restarts:
            origin = whole[first].copy()
            if not self.is_exact:
                origin[:2] -= 0.004
            poses[first:] = between(np.broadcast_to(origin, whole[first:].shape), whole[first:])
        return poses

    @property
    def ranges_m(self):
        return Room(n_scans=self.n_scans).ranges_m


@pytest.mark.parametrize(
    ("restarts", "is_exact"),
    [((60,), True), ((60,), False), ((40, 80), True), ((40, 80), False), ((6,), True)],
)
@pytest.mark.parametrize("source", ["tf", "odometry"])
def test_poses_go_on_from_where_they_were(source, restarts, is_exact, tmp_path):
    world = Restarted(with_tf=source == "tf", with_odometry=source == "odometry")
    world.restarts, world.is_exact = restarts, is_exact
    log, report = read(tmp_path, world)
    (line,) = [line for line in report.warnings if "started anew" in line]
    assert line.count(" deg at t = ") == len(restarts)
    assert f"at t = {restarts[0] / 10:.1f} s" in line
    np.testing.assert_allclose(log.odometry[: restarts[0]], Room().poses[: restarts[0]], atol=1e-6)
    steps = [between(poses[:-1], poses[1:]) for poses in (log.odometry, Room().poses)]
    is_joint = np.isin(np.arange(119), np.array(restarts) - 1)
    np.testing.assert_allclose(steps[0][~is_joint], steps[1][~is_joint], atol=1e-6)
    np.testing.assert_allclose(steps[0][is_joint], steps[1][is_joint], atol=0.02)


def test_a_robot_that_drives_back_through_its_origin_was_not_restarted(tmp_path):
    class Returning(Room):
        @staticmethod
        def poses_at(numbers):
            x = 0.05 * np.abs(numbers - 60.0)
            return np.column_stack([x, np.zeros((x.size, 2))])

    _, report = read(tmp_path, Returning())
    assert not any("anew" in line for line in report.warnings)


def test_fast_poses_far_apart_that_pass_the_origin_were_not_restarted(tmp_path):
    class Fast(Room):
        @staticmethod
        def poses_at(numbers):
            return np.column_stack([0.5 * (numbers - 60.0), np.full((numbers.size, 2), 0.005)])

    _, report = read(tmp_path, Fast(first_rad=-0.2, step_rad=0.003))
    assert not any("anew" in line for line in report.warnings)
