"""A clock that is set while a recording is made, and single poses on another clock."""

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import START_NS, stamp


class Reset(Room):
    """A room of which the first 40 scans, and poses with them, are stamped by another clock."""

    shift_ns = -1_600_000_000 * 10**9

    def messages(self):
        for topic, kind, logged_ns, fields in super().messages():
            for header in (
                [fields["header"]] if "header" in fields else [one["header"] for one in fields["transforms"]]
            ):
                stamp_ns = header["stamp"]["sec"] * 10**9 + header["stamp"]["nanosec"]
                if START_NS <= stamp_ns < self.stamps_ns[40]:
                    header["stamp"] = stamp(stamp_ns + self.shift_ns)
            yield topic, kind, logged_ns, fields


@pytest.mark.parametrize("shift_ns", [-1_600_000_000 * 10**9, 3600 * 10**9])
def test_what_was_stamped_before_the_clock_was_set_is_moved_to_the_clock_of_most_scans(shift_ns, tmp_path):
    world = Reset()
    world.shift_ns = shift_ns
    log, report = read(tmp_path, world)
    assert "the clock was set while it was made: /scan jumps by" in report.warnings[0]
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)
    assert report.out_of_order == 0


def test_single_poses_on_another_clock_are_left_out(tmp_path):
    class Odd(Room):
        def messages(self):
            for number, (topic, kind, logged_ns, fields) in enumerate(super().messages()):
                if topic == "/odom" and number < 12:
                    fields["header"]["stamp"] = stamp(700 * 10**9 + number)
                yield topic, kind, logged_ns, fields

    world = Odd(with_tf=False)
    _, report = read(tmp_path, world)
    assert report.odometry_longest_gap_s < 1.0
    assert any("stamped more than a week from the scans" in why for why in report.dropped)


def test_scans_that_never_change_while_the_odometry_moves_are_refused(tmp_path):
    world = Room()
    ranges_m = world.ranges_m[0]
    world.change = lambda _number, fields: fields.update(ranges=ranges_m)
    with pytest.raises(
        LogError, match=r"all 120 scans have the same ranges while the odometry drives 3\.\d m"
    ):
        read(tmp_path, world)
