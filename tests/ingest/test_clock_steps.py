"""A clock that is set while a recording is made, where the times of recording go on, and what only looks like that."""

from dataclasses import dataclass

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.written import PERIOD_NS, move_stamps, write_bag1, write_bag2

SOURCES = {"laser": ("/scan",), "odometry": ("/odom", "/tf"), "all": ("/scan", "/odom", "/tf")}


class Late(Room):
    """A room whose messages are recorded 20 ms after their stamps; some stamps and times of recording are changed.

    `moved_ns` says for a topic and the number of a message by how much stamp and time of recording move.
    """

    moved_ns = staticmethod(lambda _topic, _number: (0, 0))

    def messages(self):
        counts = {}
        for topic, kind, logged_ns, fields in super().messages():
            number = counts[topic] = counts.get(topic, -1) + 1
            stamp_ns, later_ns = self.moved_ns(topic, number)
            if topic != "/tf_static":
                move_stamps(fields, stamp_ns)
            yield topic, kind, logged_ns + 20_000_000 + later_ns, fields


def clock_warnings(report):
    return [line for line in report.warnings if "clock" in line]


@pytest.mark.parametrize("first", [30, 80])
@pytest.mark.parametrize("step_s", [-8.0, -3.0, -0.5, 0.5, 3.0, 7200.0])
@pytest.mark.parametrize("which", SOURCES)
def test_stamps_are_put_on_one_clock_whichever_was_set(which, step_s, first, tmp_path):
    world = Late()
    world.moved_ns = lambda topic, number: (
        round(step_s * 1e9) * (topic in SOURCES[which] and number >= first),
        0,
    )
    log, report = read(tmp_path, world)
    (line,) = clock_warnings(report)
    assert "the clock was set while it was made" in line
    assert f"{'/scan' if which != 'odometry' else '/odom'} jumps by {step_s:+.3f} s" in line
    kept_ns = round(step_s * 1e9) if which == "all" and first < world.n_scans / 2 else 0
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns + kept_ns)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)
    assert report.out_of_order == 0


def test_a_clock_that_was_wrong_at_first_and_set_back_and_forth_is_mended_as_well(tmp_path):
    world = Late()
    world.moved_ns = lambda topic, number: (2 * 10**9 * (topic != "/scan" and 40 <= number < 70), 0)
    log, report = read(tmp_path, world)
    assert "/odom jumps by +2.000 s, -2.000 s" in clock_warnings(report)[0]
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


def stalled(_topic, number):
    """Nothing is recorded for two seconds, then all that was held back at once."""
    return 0, max(0, 20 - (number - 50)) * PERIOD_NS if number >= 50 else 0


def slow(topic, number):
    """From some message on one source is recorded a second late, as by a program that became slow."""
    return 0, 10**9 * (topic == "/scan" and number >= 60)


def falls_behind(topic, number):
    """A program falls behind more and more, and then forgets what waits."""
    return 0, round(1.5e9 * number / 60) if topic == "/scan" and number < 60 else 0


def paused(_topic, number):
    """Messages go on after a pause, with stamps that go on as well, as of a simulation that was held."""
    return 0, 3 * 10**9 * (number >= 60)


def jitters(topic, number):
    """The stamps of a source that has no clock of its own."""
    return (int(np.random.default_rng(number).integers(-400, 400)) * 10**6 * (topic != "/scan"), 0)


@pytest.mark.parametrize("moved_ns", [stalled, slow, falls_behind, paused, jitters])
def test_times_of_recording_that_are_late_are_no_clock_that_was_set(moved_ns, tmp_path):
    world = Late(with_tf=False)
    world.moved_ns = moved_ns
    _, report = read(tmp_path, world)
    assert not any("was set while it was made" in line for line in report.warnings)


@dataclass
class Flushed(Late):
    """One source is recorded late, until what waits is dropped at once; from then on it is recorded in time."""

    late_s: float = 1.0
    first: int = 60
    which: tuple[str, ...] = ("/scan",)

    def messages(self):
        counts = {}
        for topic, kind, logged_ns, fields in super().messages():
            number = counts[topic] = counts.get(topic, -1) + 1
            if topic in self.which and self.first <= number < self.first + round(10 * self.late_s):
                continue
            is_late = topic in self.which and number < self.first
            yield topic, kind, logged_ns + round(self.late_s * 1e9) * is_late, fields


@pytest.mark.parametrize("late_s", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("first", [30, 60, 80])
@pytest.mark.parametrize("which", ["laser", "odometry"])
def test_a_slow_program_that_drops_what_waits_is_no_clock_that_was_set(which, first, late_s, tmp_path):
    world = Flushed(late_s=late_s, first=first, which=SOURCES[which])
    log, report = read(tmp_path, world)
    assert not clock_warnings(report)
    at = np.searchsorted(world.stamps_ns, log.stamps_ns)
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns[at])
    is_known = (which == "laser") | (at < first) | (at >= first + round(10 * late_s))
    np.testing.assert_allclose(log.odometry[is_known], world.poses[at[is_known]], atol=1e-6)


@pytest.mark.parametrize("late_s", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("first", [30, 60, 80])
def test_a_late_recorder_that_drops_what_waits_of_all_sources_is_no_clock_that_was_set(
    first, late_s, tmp_path
):
    world = Flushed(late_s=late_s, first=first, which=SOURCES["all"])
    log, report = read(tmp_path, world)
    assert not clock_warnings(report)
    at = np.searchsorted(world.stamps_ns, log.stamps_ns)
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns[at])
    np.testing.assert_allclose(log.odometry, world.poses[at], atol=1e-6)


@pytest.mark.parametrize("which", ["laser", "odometry"])
def test_where_nothing_turns_stamps_of_a_late_program_stay_and_that_is_said(which, tmp_path):
    class Straight(Flushed):
        @staticmethod
        def poses_at(numbers):
            return np.column_stack([0.03 * numbers, 0.0 * numbers, 0.0 * numbers])

    world = Straight(which=SOURCES[which])
    log, report = read(tmp_path, world)
    (line,) = clock_warnings(report)
    assert f"{SOURCES[which][0]} jumps by +1.000 s" in line
    assert "whether the clock was set or messages that waited were lost is not told" in line
    assert np.isin(log.stamps_ns, world.stamps_ns).all()


def test_messages_that_were_lost_are_no_clock_that_was_set(tmp_path):
    class Lossy(Late):
        def messages(self):
            for number, message in enumerate(super().messages()):
                if not 150 < number < 210:
                    yield message

    log, report = read(tmp_path, Lossy())
    assert not clock_warnings(report)
    assert log.n_scans < 105


def written_to(container, tmp_path, world):
    if container == "bag":
        return write_bag1(tmp_path / "a.bag", world)
    plugin = StoragePlugin.MCAP if container == "mcap" else StoragePlugin.SQLITE3
    return write_bag2(tmp_path / "a", world, plugin)


@pytest.mark.parametrize("back_s", [0.5, 2.0, 7.0])
@pytest.mark.parametrize("container", ["bag", "db3", "mcap"])
def test_a_clock_of_everything_that_was_set_back_is_told_by_the_order_of_writing(container, back_s, tmp_path):
    """All readers sort by the times of recording, which mixes what came before and after."""
    world = Late()
    back_ns = round(back_s * 1e9)
    world.moved_ns = lambda topic, number: (-back_ns, -back_ns) if number >= 70 else (0, 0)
    log, report = read_recordings([written_to(container, tmp_path, world)], IngestSettings())
    (line,) = clock_warnings(report)
    assert f"/scan jumps by {0.1 - back_s:+.3f} s" in line
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


class Sorted(Late):
    """The same messages in the order of their times of recording."""

    def messages(self):
        return iter(sorted(super().messages(), key=lambda message: message[2]))


@pytest.mark.parametrize("back_s", [1.0, 2.5])
def test_of_messages_that_were_sorted_since_those_that_are_mixed_are_left_out(back_s, tmp_path):
    world = Sorted()
    back_ns = round(back_s * 1e9) + 30_000_000
    world.moved_ns = lambda topic, number: (-back_ns, -back_ns) if number >= 70 else (0, 0)
    log, report = read(tmp_path, world)
    (line,) = [line for line in report.warnings if "two places in turn" in line]
    assert "the clock was set back" in line
    assert "left out" in line
    n_mixed = round(20 * back_s)
    assert abs(world.n_scans - log.n_scans - n_mixed) <= 4
    first = np.flatnonzero(np.diff(log.stamps_ns) > 10**9)[0] + 1
    np.testing.assert_allclose(log.odometry[:first], world.poses[:first], atol=1e-6)
    np.testing.assert_allclose(log.odometry[first:], world.poses[first - log.n_scans :], atol=1e-6)


def test_a_recorder_whose_own_clock_was_set_back_moves_no_stamps(tmp_path):
    world = Late()
    world.moved_ns = lambda _topic, number: (0, -2 * 10**9 if number >= 70 else 0)
    log, report = read(tmp_path, world)
    assert not clock_warnings(report)
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


def test_a_laser_that_goes_on_twice_as_often_is_not_taken_for_a_clock_that_was_set(tmp_path):
    class Faster(Late):
        def messages(self):
            for number, message in enumerate(super().messages()):
                if number > 150 or number // 3 % 2:
                    yield message

    log, report = read(tmp_path, Faster())
    assert not clock_warnings(report)
    assert log.n_scans > 80


@pytest.mark.parametrize("first", [60, 61, 62, 63])
@pytest.mark.parametrize("back_s", [0.4, 0.5, 0.65])
def test_a_clock_of_everything_that_was_set_back_by_little_is_told_with_few_scans(back_s, first, tmp_path):
    class Seldom(Late):
        def messages(self):
            for number, message in enumerate(super().messages()):
                # Every other scan: five in a second.
                if message[0] != "/scan" or number % 2:
                    yield message

    world = Seldom()
    world.moved_ns = lambda topic, number: (round(-back_s * 1e9) * (number >= first),) * 2
    _, report = read_recordings([write_bag1(tmp_path / "log.bag", world)], IngestSettings())
    (line,) = clock_warnings(report)
    assert "the clock was set while it was made: /scan jumps by -0." in line
