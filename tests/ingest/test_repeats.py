"""A recording that was played again and again while it was recorded, and messages that stand in the wrong order."""

import copy
from dataclasses import dataclass

import numpy as np
import pytest

from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.rooms import Room
from tests.ingest.test_choices import read
from tests.ingest.test_clock_steps import Late, clock_warnings
from tests.ingest.written import PERIOD_NS, START_NS, move_stamps, stamp, write_bag2

PASS_NS = 120 * PERIOD_NS


@dataclass
class Played(Late):
    """A room that is played several times; of each pass some scans, of a number, are recorded."""

    passes: tuple[tuple[int, int], ...] = ((0, 120), (0, 120))
    noise_m: float = 0.0

    def messages(self):
        messages = list(super().messages())
        yield from (one for one in messages if one[0] == "/tf_static")
        rng = np.random.default_rng(7)
        for number, (first, last) in enumerate(self.passes):
            for topic, kind, logged_ns, known in messages:
                scan = (logged_ns - START_NS) // PERIOD_NS
                if topic == "/tf_static" or not first <= scan < last:
                    continue
                fields = copy.deepcopy(known)
                if topic == "/scan" and number:
                    fields["ranges"] += rng.normal(0.0, self.noise_m, 121).astype(np.float32)
                yield topic, kind, logged_ns + number * PASS_NS, fields


@pytest.mark.parametrize("passes", [((0, 120),) * 3, ((50, 120), (0, 120), (0, 33)), ((70, 120), (0, 90))])
def test_of_a_recording_that_was_played_in_a_loop_each_message_is_used_once(passes, tmp_path):
    world = Played(passes=passes)
    log, report = read(tmp_path, world)
    (line,) = report.warnings
    assert f"a recording that was played {len(passes)} times" in line
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns)
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)
    assert report.out_of_order == 0


def test_other_scans_with_stamps_that_were_there_are_of_a_clock_that_was_set(tmp_path):
    world = Played(noise_m=0.003)
    _, report = read(tmp_path, world)
    (line,) = [one for one in report.warnings if "clock" in one]
    assert "/scan jumps by -12.000 s" in line


def doubled(messages, factor=1.0):
    """Each scan is sent twice, the second time with other ranges where a factor says so."""
    for topic, kind, logged_ns, known in messages:
        yield topic, kind, logged_ns, known
        if topic == "/scan":
            fields = copy.deepcopy(known)
            fields["ranges"] = fields["ranges"] * np.float32(factor)
            yield topic, kind, logged_ns + 1000, fields


@dataclass
class PlayedLayers(Played):
    """A laser with two layers, of which both have the stamp of the sweep."""

    def messages(self):
        yield from doubled(super().messages(), 1.01)


def test_layers_of_one_stamp_are_no_passes_and_all_used(tmp_path):
    world = PlayedLayers(passes=((0, 120),) * 3)
    log, report = read(tmp_path, world)
    assert "a recording that was played 3 times" in report.warnings[0]
    np.testing.assert_array_equal(log.stamps_ns, np.repeat(world.stamps_ns, 2))


@dataclass
class SetBackDoubled(Room):
    """The clock was set back by some seconds while each scan was sent twice."""

    back_s: float = 3.05

    def messages(self):
        for topic, kind, logged_ns, known in doubled(super().messages()):
            fields = copy.deepcopy(known)
            if topic != "/tf_static" and logged_ns >= START_NS + 60 * PERIOD_NS:
                for one in [fields] if "header" in fields else fields["transforms"]:
                    at = one["header"]["stamp"]
                    stamp_ns = at["sec"] * 10**9 + at["nanosec"]
                    one["header"]["stamp"] = stamp(stamp_ns - round(self.back_s * 1e9))
            yield topic, kind, logged_ns, fields


def test_scans_that_are_sent_twice_are_no_passes_where_the_clock_was_set_back(tmp_path):
    world = SetBackDoubled()
    log, report = read(tmp_path, world)
    (line,) = report.warnings
    assert "/scan jumps by -3.050 s" in line
    assert log.n_scans == world.n_scans
    np.testing.assert_allclose(log.odometry, world.poses, atol=1e-6)


@dataclass
class OutOfOrder(Room):
    """Messages stand in the file by blocks of scans, those from a number to another."""

    blocks: tuple[tuple[int, int], ...] = ((0, 120),)
    back_s: float = 0.0
    """By how much the clock was set back before each further block."""

    def messages(self):
        messages = list(super().messages())
        yield messages[0]
        for number, (first, last) in enumerate(self.blocks):
            shift_ns = -round(number * self.back_s * 1e9)
            for topic, kind, logged_ns, fields in messages[1:]:
                if first <= (logged_ns - START_NS) // PERIOD_NS < last:
                    move_stamps(fields, shift_ns)
                    yield topic, kind, logged_ns + shift_ns, fields


def damaged(tmp_path, world):
    """What is read of a database whose last page is gone."""
    (whole,) = write_bag2(tmp_path / "bag", world).glob("*.db3")
    path = tmp_path / "damaged.db3"
    path.write_bytes(whole.read_bytes()[:-4096])
    return read_recordings([path], IngestSettings())


@pytest.mark.parametrize(
    "blocks", [((70, 120), (0, 70)), ((0, 20), (80, 120), (20, 80)), ((80, 119), (40, 79), (0, 40))]
)
def test_rows_of_a_damaged_database_that_stand_in_the_wrong_order_are_put_in_that_of_time(blocks, tmp_path):
    world = OutOfOrder(blocks=blocks)
    log, report = damaged(tmp_path, world)
    (line,) = [one for one in report.warnings if "jumps by" in one]
    assert "its messages do not stand in the order of time" in line
    assert not clock_warnings(report)
    assert report.out_of_order == 0
    at = np.searchsorted(world.stamps_ns, log.stamps_ns)
    assert at.size > 100
    np.testing.assert_array_equal(log.stamps_ns, world.stamps_ns[at])
    np.testing.assert_allclose(log.odometry, world.poses[at], atol=1e-6)


@pytest.mark.parametrize("back_s", [6.0, 11.0, 17.3, 3600.0])
def test_a_clock_that_was_set_back_is_told_from_rows_in_the_wrong_order(back_s, tmp_path):
    world = OutOfOrder(blocks=((0, 70), (70, 120)), back_s=back_s)
    _, report = damaged(tmp_path, world)
    (line,) = clock_warnings(report)
    assert f"/scan jumps by {0.1 - back_s:+.3f} s" in line
