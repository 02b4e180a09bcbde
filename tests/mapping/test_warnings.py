"""Every warning appears where it must, and nowhere else."""

import numpy as np

from dynmap_cli.mapping.warnings import (
    warn_of_bent_path,
    warn_of_contradictions,
    warn_of_corridors,
    warn_of_lost_scans,
    warn_of_missing_loops,
    warn_of_odometry,
    warn_of_wheels,
)
from dynmap_cli.scan_matching.calibration import Calibration
from dynmap_cli.scan_matching.wheel_faults import WheelFault


def fault(is_frozen, odometry_m, scans_m):
    return WheelFault(is_frozen, (1, 2), 31.2, 36.2, odometry_m, 0.0, scans_m, 0.1)


def test_a_lag_is_named_and_good_stamps_are_not():
    assert warn_of_odometry(Calibration(lag_s=0.11)) == ["odometry lags the scans by 0.11 s; taken out"]
    assert "runs ahead of the scans by 0.46 scans" in warn_of_odometry(Calibration(lag_scans=-0.46))[0]
    assert warn_of_odometry(Calibration(lag_s=0.02)) == warn_of_odometry(Calibration(lag_scans=0.1)) == []


def test_a_missing_sign_is_named_and_a_sign_is_not():
    assert "never runs backwards although the robot does" in warn_of_odometry(Calibration(reversible=True))[0]
    assert warn_of_odometry(Calibration()) == []


def test_a_freeze_and_a_slip_are_named_with_their_times():
    (frozen,) = warn_of_wheels([fault(True, 0.0, 2.1)])
    assert frozen.startswith("odometry stood still from t = 31.2 s to 36.2 s while the robot moved 2.1 m")
    (slipped,) = warn_of_wheels([fault(False, 1.5, 0.1)])
    assert slipped.startswith("wheels slipped from t = 31.2 s to 36.2 s: counted 1.5 m")
    (jumped,) = warn_of_wheels([fault(False, 0.1, 0.9)])
    assert jumped.startswith("odometry was wrong from")
    assert warn_of_wheels([]) == []


def test_many_faults_are_counted():
    lines = warn_of_wheels([fault(True, 0.0, 2.1)] * 9)
    assert len(lines) == 6
    assert "4 more times" in lines[-1]
    assert "wrong once more" in warn_of_wheels([fault(True, 0.0, 2.1)] * 6)[-1]


def along(n, step_m=0.1):
    return np.column_stack([np.arange(n) * step_m, np.zeros(n), np.zeros(n)])


def test_a_corridor_is_named_with_its_length_and_a_room_is_not():
    bare, room = np.diag([0.0, 3e5, 4e5]), np.diag([1e4, 3e5, 4e5])
    information = np.array([bare] * 200 + [room] * 100)
    (line,) = warn_of_corridors(along(300), information, has_odometry=True)
    assert line.startswith("corridor: 20 m with no information along it")
    assert line.endswith("comes from the odometry")
    assert warn_of_corridors(along(300), np.array([room] * 300), has_odometry=True) == []


def test_without_odometry_a_gap_is_filled_by_constant_motion():
    information = np.array([np.diag([0.0, 3e5, 4e5])] * 300)
    assert warn_of_corridors(along(300), information, has_odometry=False)[0].endswith("from constant motion")
    assert warn_of_lost_scans(3, 100, has_odometry=False)[0].endswith("poses come from constant motion")


def test_driving_across_the_unknown_direction_is_no_corridor():
    unknown_y = np.array([np.diag([3e5, 0.0, 4e5])] * 300)
    assert warn_of_corridors(along(300), unknown_y, has_odometry=True) == []


def test_a_few_bare_scans_are_no_corridor():
    bare, room = np.diag([0.0, 3e5, 4e5]), np.diag([1e4, 3e5, 4e5])
    information = np.array(([bare] * 20 + [room] * 10) * 10)
    assert warn_of_corridors(along(300), information, has_odometry=True) == []


def test_a_return_without_a_loop_is_named():
    there_and_back = np.concatenate([along(300), along(300)[::-1]])
    assert "no loop found although the path returns within 1 m" in warn_of_missing_loops(there_and_back, 0)[0]
    assert warn_of_missing_loops(there_and_back, 1) == []
    assert warn_of_missing_loops(along(300), 0) == []
    assert warn_of_missing_loops(np.concatenate([along(60), along(60)[::-1]]), 0) == []
    assert warn_of_missing_loops(np.zeros((1, 3)), 0) == []


def test_a_long_path_that_never_returns_is_named():
    assert warn_of_missing_loops(along(601), 0) == [
        "no place was seen twice on 60 m: the overall shape of the map is unverified"
    ]
    assert warn_of_missing_loops(along(601), 1) == warn_of_missing_loops(along(401), 0) == []


def turning(n, step_rad):
    return np.column_stack([np.zeros((n, 2)), np.arange(n) * step_rad])


def steps(n, step_rad):
    motion = np.zeros((n, 3))
    motion[1:, 2] = step_rad
    return motion


def test_a_path_that_bends_away_from_the_odometry_is_named():
    (line,) = warn_of_bent_path(steps(301, 0.101), turning(301, 0.1), 0)
    assert "departs from the odometry's by -17 deg" in line
    assert warn_of_bent_path(steps(301, 0.101), turning(301, 0.1), 1) == []
    assert warn_of_bent_path(steps(301, 0.1002), turning(301, 0.1), 0) == []


def test_steps_without_odometry_do_not_bend_the_path():
    assert warn_of_bent_path(np.full((301, 3), np.nan), turning(301, 0.1), 0) == []


def test_lost_scans_and_contradictions_are_named():
    (line,) = warn_of_lost_scans(3, 100, has_odometry=True)
    assert line == "3 of 100 scans fitted nowhere; their poses come from the odometry"
    assert warn_of_lost_scans(0, 100, has_odometry=True) == []
    assert "12 % of the places seen twice contradict" in warn_of_contradictions(0.12)[0]
    assert warn_of_contradictions(0.02) == []
