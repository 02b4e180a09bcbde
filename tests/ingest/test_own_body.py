"""Beams that see the robot itself are found by what never moves, and walls that keep their distance are not."""

import math
from dataclasses import dataclass, field

import numpy as np
import pytest

from dynmap_cli.errors import LogError
from dynmap_cli.ingest.choices.own_body import moves_of, own_body
from dynmap_cli.ingest.reading import read_recordings
from dynmap_cli.ingest.settings import IngestSettings
from tests.cli.conftest import run_dynmap
from tests.ingest.written import World, write_bag1

BEARINGS = np.radians(np.arange(-180.0, 180.0, 4.0))
BODY = np.flatnonzero(np.abs(np.degrees(BEARINGS) - 120.0) <= 9.0)
RANDOM = np.random.default_rng(5)


def drive(*legs):
    """Poses of straight legs (metres) and turns on the spot ((degrees,)), in steps of 5 cm and 3 degrees."""
    poses = [np.zeros(3)]
    for leg in legs:
        is_turn = isinstance(leg, tuple)
        count = max(int(abs(leg[0]) / 3.0 if is_turn else abs(leg) / 0.05), 1)
        for _ in range(count):
            x, y, yaw = poses[-1]
            if is_turn:
                poses.append(np.array([x, y, yaw + math.radians(leg[0]) / count]))
            else:
                step = leg / count
                poses.append(np.array([x + step * math.cos(yaw), y + step * math.sin(yaw), yaw]))
    return np.array(poses)


def room(poses, low=(-3.0, -0.6), high=(6.0, 4.0)):
    """Distance to the walls of a rectangle along each beam, (n, n_beams), with noise."""
    angles = poses[:, 2:] + BEARINGS
    along = np.stack([np.cos(angles), np.sin(angles)])
    at = poses[:, :2].T[:, :, None]
    limits = np.where(along > 0, np.array(high)[:, None, None], np.array(low)[:, None, None])
    with np.errstate(divide="ignore"):
        ranges = np.min(np.abs((limits - at) / along), axis=0)
    return (ranges + RANDOM.normal(0.0, 0.005, ranges.shape)).astype(np.float32)


def with_body(ranges):
    """The same with a part of the robot 0.3 m away."""
    changed = ranges.copy()
    changed[:, BODY] = 0.3 + RANDOM.normal(0.0, 0.005, (len(ranges), BODY.size))
    return changed


def found(ranges, poses):
    moves = moves_of(poses, np.ones(len(poses), dtype=bool))
    return np.flatnonzero(np.isfinite(own_body(ranges, moves, 0.05))) if moves.is_enough else np.zeros(0, int)


THERE_AND_BACK = drive(4.0, (180.0,), 4.0, (-180.0,), 2.0, (90.0,), 1.0)


def test_a_part_of_the_robot_is_found_and_nothing_else():
    np.testing.assert_array_equal(found(with_body(room(THERE_AND_BACK)), THERE_AND_BACK), BODY)


def test_a_wall_at_a_constant_distance_is_not_the_robot():
    """The wall is 0.6 m to the right all the way there, and to the left all the way back."""
    assert found(room(THERE_AND_BACK), THERE_AND_BACK).size == 0


def test_a_pillar_that_is_driven_around_is_not_the_robot():
    """At 0.5 m to the left in all scans; driven the other way it is to the right."""
    turns = np.radians(np.arange(0.0, 720.0, 4.0))
    around = np.column_stack([np.cos(turns), np.sin(turns), turns + math.pi / 2])
    back = around[::-1] + np.array([0.0, 0.0, math.pi])
    left = int(np.argmin(np.abs(BEARINGS - math.pi / 2)))
    right = int(np.argmin(np.abs(BEARINGS + math.pi / 2)))
    ranges = np.full((len(around), BEARINGS.size), 5.0, dtype=np.float32)
    ranges[:, left] = 0.5
    assert found(ranges, around).size == 0
    other = np.full_like(ranges, 5.0)
    other[:, right] = 0.5
    assert found(np.concatenate([ranges, other]), np.concatenate([around, back])).size == 0


@pytest.mark.parametrize("legs", [(10.0,), (0.5, (360.0,), (-360.0,)), (4.0, (90.0,), 4.0, (90.0,), 2.0)])
def test_without_metres_and_turns_to_both_sides_nobody_knows(legs):
    poses = drive(*legs)
    assert found(with_body(room(poses)), poses).size == 0


def plain_moves(poses):
    """Scan after scan, each compared with the last that was chosen."""
    chosen = [0]
    for row in range(1, len(poses)):
        step = poses[row] - poses[chosen[-1]]
        turn = (step[2] + np.pi) % (2.0 * np.pi) - np.pi
        if np.hypot(step[0], step[1]) >= 0.1 or abs(turn) >= np.radians(5.0):
            chosen.append(row)
    return chosen


@pytest.mark.parametrize("size", [1, 2, 16, 17, 2048, 2049, 2064, 6000])
def test_moves_are_those_found_scan_by_scan(size):
    draw = np.random.default_rng(size)
    speeds_m = draw.choice([0.0, 0.001, 0.02, 0.11], size)
    speeds_m[np.repeat(draw.random(size // 100 + 1) < 0.5, 100)[:size]] = 0.0
    yaw = np.cumsum(draw.normal(0.0, 0.02, size) * (speeds_m > 0.0))
    poses = np.column_stack([np.cumsum(speeds_m * np.cos(yaw)), np.cumsum(speeds_m * np.sin(yaw)), yaw])
    np.testing.assert_array_equal(moves_of(poses, np.ones(size, dtype=bool)).rows, plain_moves(poses))


def test_a_robot_that_stands_with_noisy_odometry_does_not_move():
    poses = RANDOM.normal(0.0, 0.002, (5000, 3))
    moves = moves_of(poses, np.ones(5000, dtype=bool))
    assert moves.rows.size == 1
    assert not moves.is_enough


@dataclass
class Driven(World):
    """A drive with turns, a laser whose beams are those of this module, and a part of the robot in sight."""

    path: np.ndarray = field(default_factory=lambda: THERE_AND_BACK)
    seen: np.ndarray = field(default_factory=lambda: with_body(room(THERE_AND_BACK)))

    @property
    def poses(self):
        return self.path

    @property
    def ranges_m(self):
        return self.seen


def written(tmp_path, mounting=(0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0)):
    n_scans, n_beams = len(THERE_AND_BACK), BEARINGS.size
    world = Driven(n_scans, n_beams, first_rad=BEARINGS[0], step_rad=math.radians(4.0), mounting=mounting)
    return write_bag1(tmp_path / "a.bag", world), world


def test_what_is_found_is_said_and_left_out(tmp_path):
    path, world = written(tmp_path)
    log, report = read_recordings([path], IngestSettings())
    assert np.isnan(log.ranges_m[:, BODY]).all()
    others = np.setdiff1d(np.arange(BEARINGS.size), BODY)
    expected = world.seen[:, others]
    np.testing.assert_array_equal(log.ranges_m[:, others][expected < 8.0], expected[expected < 8.0])
    assert (
        f"{BODY.size} beams between 112 and 128 deg hit the robot itself, at 0.30" in report.lasers[0].masked
    )
    assert any("hit the robot itself" in line for line in report.lines())
    result = run_dynmap("check", path)
    assert "  masked        /scan: 5 beams between 112 and 128 deg hit the robot itself" in result.stdout


@pytest.mark.parametrize("turn_deg", [0.0, 90.0])
def test_sectors_are_in_the_frame_of_the_robot(tmp_path, turn_deg):
    half = math.radians(turn_deg) / 2
    path, _ = written(tmp_path, (0.1, 0.0, 0.3, 0.0, 0.0, math.sin(half), math.cos(half)))
    log, report = read_recordings(
        [path], IngestSettings(mask_sectors=((170.0, -170.0), (10.0, 30.0, "/scan"), (0, 90, "/x")))
    )
    degrees = (np.degrees(log.bearings_rad[0]) + turn_deg + 1e-6) % 360.0
    is_masked = ((degrees >= 170.0) & (degrees <= 190.1)) | ((degrees >= 10.0) & (degrees <= 30.1))
    body = np.isin(np.arange(BEARINGS.size), BODY)
    assert np.isnan(log.ranges_m[:, is_masked]).all()
    assert not np.isnan(log.ranges_m[:, ~is_masked & ~body]).all(axis=0).any()
    assert "as set: 170 to -170 deg, 10 to 30 deg" in report.lasers[0].masked


def test_a_sector_on_the_command_line(tmp_path):
    path, _ = written(tmp_path)
    result = run_dynmap("check", path, "--mask-sector", "-20,20", "--mask-sector", "170,-170,/scan")
    assert result.exit_code == 0, result.output
    assert "as set: -20 to 20 deg, 170 to -170 deg" in " ".join(result.stdout.split())
    assert run_dynmap("check", path, "--mask-sector", "wide").exit_code == 2
    assert run_dynmap("check", path, "--mask-sector", "0,360").exit_code == 3
    assert run_dynmap("check", path, "--mask-sector", "0,nan").exit_code == 2


def test_sectors_that_leave_nothing_are_refused(tmp_path):
    path, _ = written(tmp_path)
    with pytest.raises(LogError, match=r"leave 0 of the .* beams of this laser"):
        read_recordings([path], IngestSettings(mask_sectors=((0.0, 180.0), (180.0, 0.0))))
