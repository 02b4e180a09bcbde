"""Scans of fewer beams than a pose has unknowns, and the rate of scans that are written twice."""

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.ingest.written import carmen_line

N = 30


def read(tmp_path, n_beams_of, copies=1, **settings):
    path = tmp_path / "a.log"
    lines = []
    for number in range(N):
        ranges_m = 2.0 + 0.01 * number + 0.1 * np.arange(n_beams_of(number))
        pose = (0.1 * number, 0.0, 0.0)
        lines += [carmen_line(ranges_m, pose, pose, f"{1000 + 0.1 * number:.1f}")] * copies
    path.write_text("".join(lines))
    return read_recordings([path], IngestSettings(**settings))


def few(report):
    return [line for line in report.warnings if "fewer than 3 beams" in line]


@pytest.mark.parametrize("n_beams", [1, 2])
def test_scans_of_one_or_two_beams_are_said(n_beams, tmp_path):
    log, report = read(tmp_path, lambda _: n_beams)
    assert log.n_scans == N
    assert few(report) == [
        "FLASER: 30 of 30 scans have fewer than 3 beams, too few to find a pose from; odometry alone can say where "
        "the robot was"
    ]


@pytest.mark.parametrize("n_beams", [1, 2])
def test_without_odometry_they_are_refused(n_beams, tmp_path):
    with pytest.raises(
        LogError, match=r"each of the 30 scans has fewer than 3 beams, .* there is no odometry"
    ):
        read(tmp_path, lambda _: n_beams, odom="none")


def test_among_others_they_are_counted(tmp_path):
    _, report = read(tmp_path, lambda number: 2 if number % 10 == 0 else 90, odom="none")
    assert len(few(report)) == 1
    assert "3 of 30 scans" in few(report)[0]
    assert "the other scans alone" in few(report)[0]


def test_three_beams_are_enough_to_say_nothing(tmp_path):
    _, report = read(tmp_path, lambda _: 3)
    assert not few(report)


@pytest.mark.parametrize("copies", [1, 2, 3])
def test_scans_that_are_all_repeated_have_the_rate_of_those_that_stay(copies, tmp_path):
    log, report = read(tmp_path, lambda _: 90, copies)
    assert log.n_scans == N
    timing = report.lasers[0].timing
    assert timing.rate_hz == pytest.approx(10.0)
    assert (timing.is_steady, timing.missing, timing.backward) == (True, 0, 0)
