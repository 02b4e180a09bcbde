"""Generated worlds: complete, reproducible, and with a way through."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from dynmap_cli.errors import ConfigError
from dynmap_cli.simulation import load_scenario, parse_scenario, simulate
from dynmap_cli.simulation.driving import plan_drive
from dynmap_cli.simulation.shapes import shapes_of
from dynmap_cli.simulation.worlds import expand

KINDS = ("office", "warehouse", "home", "crowd", "car_park")
WORLDS = Path(__file__).resolve().parents[2] / "configs" / "worlds"
SCENARIOS = sorted(WORLDS.glob("*.yaml"))


def generated(kind, **changes):
    content = {"seed": 4, "generate": {"kind": kind, "talking": 1, "carts": 1}}
    content["lasers"] = [{"rate_hz": 0.4, "beams": 46, "fov_deg": 270}]
    return {**content, **changes}


def crosses(start, end, walls):
    """Whether segments start -> end (n, 2) cross any wall (m, 4)."""
    a, b = start[:, None], end[:, None]
    c, d = walls[None, :, :2], walls[None, :, 2:]

    def side(p, q, r):
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (
            r[..., 0] - p[..., 0]
        )

    return ((side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)).any(axis=1)


def clear_of_walls(scenario):
    """Share of the ways of a patrol that cross nothing, whatever state things are in."""
    written_out = expand(scenario)
    drive, shapes = plan_drive(written_out.robot), shapes_of(written_out.world)
    path = drive.at(np.arange(0.0, drive.duration_s, 0.5))[:, :2]
    path = path[np.concatenate([[True], np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-3])][:2000]
    blocked = crosses(path[:-1], path[1:], shapes.segments)
    return not blocked.any()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(2))
def test_the_patrol_drives_through_nothing(kind, seed):
    assert clear_of_walls(
        parse_scenario({"seed": seed, "generate": {"kind": kind, "boxes": 8}, "robot": {"repeat": 3}})
    )


@pytest.mark.parametrize("kind", KINDS)
def test_a_generated_world_is_seen_and_the_same_again(kind):
    run, again = (simulate(parse_scenario(generated(kind))) for _ in range(2))
    assert run.log.ranges_m.tobytes() == again.log.ranges_m.tobytes()
    assert np.isfinite(run.log.ranges_m).mean() > 0.3
    assert run.object_states.shape[1] >= 4
    other = simulate(parse_scenario(generated(kind, seed=5)))
    assert run.shapes.segments.shape != other.shapes.segments.shape or (
        not np.array_equal(run.shapes.segments, other.shapes.segments)
    )


def test_a_building_of_its_own_seed_stays_while_people_and_noise_change():
    first, second = (
        simulate(parse_scenario(generated("home", seed=seed, generate={"kind": "home", "seed": 9})))
        for seed in (1, 2)
    )
    np.testing.assert_array_equal(first.shapes.segments, second.shapes.segments)
    assert first.log.ranges_m.tobytes() != second.log.ranges_m.tobytes()


def test_own_walls_and_path_are_kept_beside_what_is_generated():
    wall = [[100.0, 0.0], [101.0, 0.0]]
    content = generated("crowd", world={"walls": [wall]}, robot={"path": [[5, 5], [8, 5]]})
    written_out = expand(parse_scenario(content))
    assert written_out.world.walls[0].points == ((100.0, 0.0), (101.0, 0.0))
    assert [step.to for step in written_out.robot.path] == [(5.0, 5.0), (8.0, 5.0)]
    door = {"name": "door_1", "hinge": [0, 0], "latch": [1, 0]}
    with pytest.raises(ConfigError, match="'door_1' is the name of a generated object"):
        expand(parse_scenario(generated("office", world={"doors": [door]})))


def test_a_world_too_small_to_be_drawn_is_refused():
    with pytest.raises(ConfigError, match=r"size_m = \[5.0, 5.0\] is too small for 'office'"):
        expand(parse_scenario({"generate": {"kind": "office", "size_m": [5, 5]}}))


@pytest.mark.parametrize("path", SCENARIOS, ids=lambda path: path.stem)
def test_each_scenario_says_what_it_tests_and_has_a_way_through(path):
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert 20 < len(content["about"]) < 200
    assert "\n" not in content["about"].strip()
    scenario = load_scenario(path)
    assert clear_of_walls(scenario)


def test_there_are_a_dozen_scenarios_and_the_largest_patrols_for_two_hours():
    assert len(SCENARIOS) >= 12
    drives = [plan_drive(expand(load_scenario(path)).robot) for path in SCENARIOS]
    assert max(float(np.diff(drive.times_s)[drive.recorded].sum()) for drive in drives) >= 7200
