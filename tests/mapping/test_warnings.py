"""Every warning appears where it must, and nowhere else."""

import numpy as np

from dynmap_cli.mapping.odometry import Calibration
from dynmap_cli.mapping.warnings import (
    warn_of_contradictions,
    warn_of_corridors,
    warn_of_lost_scans,
    warn_of_missing_loops,
    warn_of_odometry,
    warn_of_wheels,
)
from dynmap_cli.mapping.wheel_faults import WheelFault


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


def along(n, step_m=0.1):
    return np.column_stack([np.arange(n) * step_m, np.zeros(n), np.zeros(n)])


def test_a_corridor_is_named_with_its_length_and_a_room_is_not():
    bare, room = np.diag([0.0, 3e5, 4e5]), np.diag([1e4, 3e5, 4e5])
    information = np.array([bare] * 200 + [room] * 100)
    (line,) = warn_of_corridors(along(300), information)
    assert line.startswith("corridor: 20 m with no information along it")
    assert warn_of_corridors(along(300), np.array([room] * 300)) == []


def test_driving_across_the_unknown_direction_is_no_corridor():
    unknown_y = np.array([np.diag([3e5, 0.0, 4e5])] * 300)
    assert warn_of_corridors(along(300), unknown_y) == []


def test_a_few_bare_scans_are_no_corridor():
    bare, room = np.diag([0.0, 3e5, 4e5]), np.diag([1e4, 3e5, 4e5])
    assert warn_of_corridors(along(300), np.array(([bare] * 20 + [room] * 10) * 10)) == []


def test_a_return_without_a_loop_is_named():
    there_and_back = np.concatenate([along(300), along(300)[::-1]])
    assert "no loop found although the path returns within 1 m" in warn_of_missing_loops(there_and_back, 0)[0]
    assert warn_of_missing_loops(there_and_back, 1) == []
    assert warn_of_missing_loops(along(300), 0) == []
    assert warn_of_missing_loops(np.concatenate([along(60), along(60)[::-1]]), 0) == []
    assert warn_of_missing_loops(np.zeros((1, 3)), 0) == []


def test_lost_scans_and_contradictions_are_named():
    assert warn_of_lost_scans(3, 100) == ["3 of 100 scans fitted nowhere; their poses come from the odometry"]
    assert warn_of_lost_scans(0, 100) == []
    assert "12 % of the places seen twice contradict" in warn_of_contradictions(0.12)[0]
    assert warn_of_contradictions(0.02) == []
