"""A robot that is carried inside one recording is noticed, and when; no alarm where nothing was carried."""

import pytest

from dynmap_cli.mapping.registrar import Registrar
from dynmap_cli.mapping.warnings import warn_of_carries
from dynmap_cli.scan_matching.sweeps import sweeps_of
from dynmap_cli.simulation import parse_scenario, simulate
from tests.mapping.carried_scenes import make_carried
from tests.mapping.test_site import FIRST, WALLS


def registered(log):
    registrar = Registrar(log, 25.0)
    registrar.register(sweeps_of(log, None), "")
    return registrar


@pytest.mark.parametrize(("far_m", "how", "seed"), [(3.0, "at once", 1), (10.0, "in hands", 0)])
def test_a_carried_robot_is_noticed(far_m, how, seed):
    scene = make_carried("office", far_m, how, seed)
    log = scene.run.log
    (carry,) = registered(log).carries
    times_s = (log.stamps_ns - log.stamps_ns[0]) * 1e-9
    assert abs(times_s[carry.last_before] - scene.begin_s) < 0.5
    assert abs(times_s[carry.first_after] - scene.end_s) < 0.5


def test_no_alarm_without_a_carry():
    scenario = {
        "seed": 3,
        "world": {"walls": WALLS},
        "robot": {"path": FIRST, "speed_mps": 0.6},
        "lasers": [{"noise_m": 0.015, "rate_hz": 5, "max_range_m": 12}],
    }
    assert registered(simulate(parse_scenario(scenario)).log).carries == ()


def test_the_warning_says_when_and_what_to_do():
    (line,) = warn_of_carries([(12.34, 15.0)])
    assert "t = 12.3 s" in line
    assert "cut the recording" in line
