"""Laws of a whole simulated run."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED
from dynmap_cli.domain.poses import between, compose, transform_points
from dynmap_cli.simulation import parse_scenario, simulate
from dynmap_cli.simulation.driving import plan_drive
from dynmap_cli.simulation.movers import shapes_at, tracks
from dynmap_cli.simulation.run import count_scans
from dynmap_cli.simulation.sensing import FIRST_OBJECT, MIXED, MOVING, NO_RETURN, STATIC
from dynmap_cli.simulation.shapes import shapes_of
from dynmap_cli.simulation.worlds import expand
from tests.reference.simulation import plain_cast

EXACT = {
    "translation_scale": 1.0,
    "sigma_m_per_sqrt_m": 0,
    "sigma_deg_per_sqrt_m": 0,
    "sigma_deg_per_sqrt_turn": 0,
}
LASER = {"beams": 91, "fov_deg": 270, "noise_m": 0, "rate_hz": 4, "max_range_m": 12, "pose": [0.2, 0.1, 10]}


def room(**changes):
    """A room with a door, a box, a pillar, two people and a cart; the robot drives around in it."""
    content = {
        "seed": 5,
        "world": {
            "walls": [
                {"points": [[3, 6], [0, 6], [0, 0], [8, 0], [9, 5], [5, 6], [4, 6]]},
                [[2, 6], [2, 9], [6, 9], [6, 6]],
            ],
            "arcs": [{"center": [9, 0], "radius_m": 1.0, "from_deg": 90, "to_deg": 180}],
            "legs": [{"at": [4.5, 3.0], "radius_m": 0.1}],
            "doors": [
                {"name": "door", "hinge": [3, 6], "latch": [4, 6], "schedule": [[3, "open"], [8, "closed"]]}
            ],
            "boxes": [
                {
                    "name": "box",
                    "size_m": [0.6, 0.4],
                    "places": {"a": [1, 4, 20], "b": [6.5, 1, 0]},
                    "process": {"mean_s": 3},
                },
                {
                    "name": "chair",
                    "size_m": [0.5, 0.5],
                    "places": {"a": [7, 4, 0]},
                    "shape": "legs",
                    "absent": False,
                },
            ],
        },
        "movers": [
            {"does": "walk", "path": [[1, 1], [7, 5]]},
            {"does": "follow"},
            {"does": "walk", "shape": "cart", "path": [[7.5, 1], [7.5, 3]], "speed_mps": 0.5},
        ],
        "robot": {"path": [[2, 2], [6, 2], [6, 4], {"to": [3, 4.5], "wait_s": 1}], "speed_mps": 1.0},
        "lasers": [LASER],
        "odometry": EXACT,
    }
    return {**content, **changes}


def turned(value, angle_deg):
    """The same scenario with every place turned about the origin."""
    cos, sin = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))

    def turn(part, key=""):
        if isinstance(part, dict):
            return {name: turn(inner, name) for name, inner in part.items()}
        if isinstance(part, list | tuple) and part and all(isinstance(x, int | float) for x in part):
            if key in {"size_m", "pose", "schedule"}:
                return part
            x, y = cos * part[0] - sin * part[1], sin * part[0] + cos * part[1]
            return [x, y, part[2] + angle_deg] if len(part) == 3 else [x, y]
        if isinstance(part, list | tuple):
            return part if key == "schedule" else [turn(inner, key) for inner in part]
        return part + angle_deg if key in {"from_deg", "to_deg"} else part

    return turn(value)


@pytest.fixture(scope="module")
def run():
    return simulate(parse_scenario(room()))


def test_each_beam_belongs_to_what_is_nearest_when_everything_is_cast_alone():
    scenario = parse_scenario(room(lasers=[{**LASER, "beam_interval_s": 0.002}]))
    run = simulate(scenario)
    drive, shapes = plan_drive(scenario.robot), shapes_of(scenario.world)
    people = tracks(scenario, drive)
    gates = np.concatenate([shapes.segment_gates, shapes.circle_gates])
    times = (run.log.stamps_ns - round(scenario.start.timestamp()) * 10**9) * 1e-9
    compared = 0
    for scan in range(0, run.log.n_scans, 16):
        both = np.array([times[scan], times[scan] + 90 * 0.002])
        robot = drive.at(both)
        seen = shapes_at(people, both, robot, "legs")
        sensor = compose(robot, run.log.sensor_poses[0])
        sensor[:, 2] = robot[:, 2] + run.log.sensor_poses[0, 2]
        segments = np.vstack([np.tile(shapes.segments, 2), np.hstack([seen.segments[0], seen.segments[1]])])
        still = np.column_stack([shapes.circles[:, :2], shapes.circles])
        circles = np.vstack([still, np.hstack([seen.circles[0, :, :2], seen.circles[1]])])
        bearings = run.log.bearings_rad[0]
        alone = plain_cast(
            sensor[0], sensor[1], bearings[0], bearings[1] - bearings[0], 91, 12.0, segments, circles
        )
        there = (gates[:, 0] < 0) | (run.object_states[scan][np.maximum(gates[:, 0], 0)] == gates[:, 1])
        classes = np.where(gates[:, 0] < 0, STATIC, FIRST_OBJECT + gates[:, 0])
        n_still, n_legs = len(shapes.segments), len(shapes.circles)
        moving = np.full(len(segments) - n_still, MOVING), np.full(len(circles) - n_legs, MOVING)
        classes = np.concatenate([classes[:n_still], moving[0], classes[n_still:], moving[1]])
        present = np.concatenate([there[:n_still], moving[0] == MOVING, there[n_still:], moving[1] == MOVING])
        alone[:, ~present] = np.inf
        nearest = alone.min(axis=1)
        expected = np.where(np.isinf(nearest), NO_RETURN, classes[alone.argmin(axis=1)])
        clear = np.sort(alone, axis=1)
        clear = (clear[:, 1] - clear[:, 0] > 1e-6) | np.isinf(clear[:, 0])
        np.testing.assert_array_equal(run.beam_class[scan][clear], expected[clear])
        ends = np.isfinite(nearest) & (nearest > 0.05)
        np.testing.assert_allclose(run.log.ranges_m[scan][ends], nearest[ends], atol=1e-5)
        compared += int(clear.sum())
    assert compared > 150
    assert set(np.unique(run.beam_class)) >= {STATIC, MOVING, FIRST_OBJECT, FIRST_OBJECT + 1}


@pytest.mark.parametrize("angle_deg", [37.0, -160.0])
def test_turning_the_world_turns_everything(run, angle_deg):
    other = simulate(parse_scenario(turned(room(), angle_deg)))
    turn = np.array([0.0, 0.0, math.radians(angle_deg)])
    np.testing.assert_allclose(between(compose(turn, run.true_poses), other.true_poses), 0.0, atol=1e-9)
    np.testing.assert_allclose(other.log.odometry, run.log.odometry, atol=1e-9)
    same = np.isclose(other.log.ranges_m, run.log.ranges_m, atol=1e-4) | (
        np.isinf(other.log.ranges_m) & np.isinf(run.log.ranges_m)
    )
    assert same.mean() > 0.999
    assert (other.beam_class == run.beam_class).mean() > 0.999


def test_turning_the_map_turns_poses_and_map_and_leaves_the_measurements(run):
    other = simulate(parse_scenario(room(turn_deg=31.0)))
    np.testing.assert_array_equal(other.log.ranges_m, run.log.ranges_m)
    turn = np.array([0.0, 0.0, math.radians(31.0)])
    np.testing.assert_allclose(between(compose(turn, run.true_poses), other.true_poses), 0.0, atol=1e-9)
    rows, cols = np.nonzero(run.true_map.cells == OCCUPIED)
    walls = transform_points(turn, run.true_map.frame.to_points(np.column_stack([rows, cols])))
    row, col = other.true_map.frame.to_cells(walls).T
    near = np.zeros(row.size, dtype=bool)
    for d_row, d_col in np.ndindex(3, 3):
        near |= other.true_map.cells[row + d_row - 1, col + d_col - 1] == OCCUPIED
    assert near.all()


def test_an_empty_world_returns_nothing():
    run = simulate(parse_scenario({"robot": {"path": [[0, 0], [3, 1]]}}))
    assert run.log.n_scans > 10
    assert np.isinf(run.log.ranges_m).all()
    assert (run.beam_class == NO_RETURN).all()
    assert run.object_states.shape == (run.log.n_scans, 0)
    assert (run.true_map.cells == FREE).all()


def test_odometry_without_noise_integrates_to_the_true_path(run):
    np.testing.assert_allclose(
        between(compose(run.true_poses[0], run.log.odometry), run.true_poses), 0.0, atol=1e-9
    )


def test_end_points_without_noise_lie_on_the_walls_of_the_true_map(run):
    points = compose(run.true_poses, run.log.sensor_poses[0])
    bearings = run.log.bearings_rad[0]
    for scan in range(0, run.log.n_scans, 5):
        ends = np.isfinite(run.log.ranges_m[scan]) & (run.beam_class[scan] == STATIC)
        ranges = run.log.ranges_m[scan][ends].astype(float)[:, None]
        beams = np.column_stack([np.cos(bearings[ends]), np.sin(bearings[ends])])
        row, col = run.true_map.frame.to_cells(transform_points(points[scan], ranges * beams)).T
        near = np.zeros(row.size, dtype=bool)
        for d_row, d_col in np.ndindex(3, 3):
            near |= run.true_map.cells[row + d_row - 1, col + d_col - 1] == OCCUPIED
        assert near.all()


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    noisy = room(lasers=[{**LASER, "noise_m": 0.01, "dropout_share": 0.02}], odometry={})
    first, again = simulate(parse_scenario(noisy)), simulate(parse_scenario(noisy))
    other = simulate(parse_scenario({**noisy, "seed": 6}))
    assert first.log.ranges_m.tobytes() == again.log.ranges_m.tobytes()
    assert first.log.odometry.tobytes() == again.log.odometry.tobytes()
    assert first.log.ranges_m.tobytes() != other.log.ranges_m.tobytes()


def test_classes_and_ranges_tell_the_same_story():
    laser = {
        **LASER,
        "noise_m": 0.02,
        "dropout_share": 0.05,
        "grazing_deg": 10,
        "mixed_share": 0.5,
        "max_range_m": 6,
    }
    run = simulate(parse_scenario(room(lasers=[laser])))
    assert ((run.beam_class == NO_RETURN) == ~np.isfinite(run.log.ranges_m)).all()
    assert (run.beam_class == MIXED).any()
    assert np.nanmin(run.log.ranges_m) >= 0.05
    assert run.log.ranges_m[np.isfinite(run.log.ranges_m)].max() <= 6.0


def test_states_follow_the_schedule(run):
    times = (run.log.stamps_ns - run.log.stamps_ns[0]) * 1e-9
    np.testing.assert_array_equal(run.object_states[:, 0], (times >= 3) & (times < 8))
    assert [thing.name for thing in run.objects] == ["door", "box", "chair"]


def test_several_lasers_take_turns_and_keep_their_geometry():
    second = {"name": "rear", "beams": 61, "fov_deg": 120, "pose": [-0.3, 0, 180], "rate_hz": 8, "noise_m": 0}
    run = simulate(parse_scenario(room(lasers=[LASER, second], movers=[])))
    assert (np.diff(run.log.stamps_ns) >= 0).all()
    rear = run.log.geometry_index == 1
    assert np.isnan(run.log.ranges_m[rear][:, 61:]).all()
    assert (run.beam_class[rear][:, 61:] == NO_RETURN).all()
    assert 1.5 < rear.sum() / (~rear).sum() < 2.5
    assert count_scans(run.scenario) == run.log.n_scans


def test_nothing_is_recorded_while_the_robot_is_off():
    path = [[2, 2], {"to": [6, 2], "off_s": 100}, [6, 4]]
    run = simulate(
        parse_scenario(room(robot={"path": path, "repeat": 2, "pause_s": 50, "days": 2, "night_s": 1000}))
    )
    gaps = np.diff(run.log.stamps_ns) * 1e-9
    assert sorted(np.round(gaps[gaps > 1]).tolist()) == [50, 50, 100, 100, 100, 100, 1000]
    assert np.abs(between(run.true_poses[:-1], run.true_poses[1:])[gaps > 1, :2]).max() < 0.3


def test_the_drive_is_continuous_and_keeps_its_speeds():
    robot = parse_scenario(
        room(
            robot={
                "path": [[0, 0], [4, 0], [4, 3], {"to": [1, 3], "backwards": True}, [4, 3.5]],
                "speed_mps": 0.8,
            }
        )
    ).robot
    drive = plan_drive(robot)
    for (pose, twist), (after, _), seconds in zip(
        list(zip(drive.poses, drive.twists, strict=True))[:-1],
        list(zip(drive.poses, drive.twists, strict=True))[1:],
        np.diff(drive.times_s)[:-1],
        strict=True,
    ):
        assert np.hypot(*(after - pose)[:2]) <= abs(twist[0]) * seconds + 1e-9
    times = np.linspace(0, drive.duration_s, 4000)
    steps = np.diff(drive.at(times), axis=0) / np.diff(times)[:, None]
    assert np.hypot(steps[:, 0], steps[:, 1]).max() < 0.8 + 1e-6
    assert np.abs(steps[:, 2]).max() < math.radians(60) + 1e-6
    assert (drive.twists[:, 0] < 0).any()
    np.testing.assert_allclose(drive.at(times[-1:])[0, :2], [4, 3.5], atol=1e-9)


def test_a_standing_foot_stays_on_the_ground():
    scenario = parse_scenario(room(movers=[{"does": "walk", "path": [[0, 0], [100, 0]], "speed_mps": 1.0}]))
    times = np.arange(0.5, 7.0, 0.01)
    far = np.full((times.size, 3), 1e6)
    feet = shapes_at(tracks(scenario, plan_drive(scenario.robot)), times, far, "legs").circles[:, :, 0]
    speeds = np.diff(feet, axis=0) / 0.01
    assert ((np.abs(speeds) < 1e-6).sum(axis=1) >= 1).mean() > 0.95
    assert abs(speeds.mean() - 1.0) < 0.1
    trunk = shapes_at(tracks(scenario, plan_drive(scenario.robot)), times, far, "torso").circles
    np.testing.assert_allclose(trunk[:, 0, 0], times, atol=1e-9)


def test_followers_and_blockers_keep_their_distance_and_people_step_aside():
    movers = [{"does": "follow", "distance_m": 1.0}, {"does": "block", "distance_m": 1.5}]
    movers += [
        {"does": "walk", "path": [[2, 2], [6, 2]], "speed_mps": 0.9},
        {"does": "stand", "at": [5, 2], "count": 3},
    ]
    scenario = parse_scenario(room(movers=movers))
    drive = plan_drive(scenario.robot)
    times = np.arange(0.0, drive.duration_s, 0.1)
    robot = drive.at(times)
    for track, low, high in zip(
        tracks(scenario, drive), [0.5, 0.7, 0.5, 0.5, 0.5, 0.5], [1.2, 1.7, *[99] * 4], strict=True
    ):
        poses, _ = track.at(times, robot)
        away = np.linalg.norm(poses[:, :2] - robot[:, :2], axis=1)
        assert away.min() > low - 1e-6
        assert away.max() < high


def test_a_stream_goes_one_way_inside_its_width_and_nobody_jumps():
    stream = {"does": "stream", "path": [[0, 2], [8, 2]], "count": 6, "width_m": 2.0, "speed_mps": 1.0}
    scenario = parse_scenario(room(movers=[stream], robot={"path": [[0, 50], [40, 50]], "speed_mps": 1.0}))
    drive = plan_drive(scenario.robot)
    times = np.arange(0.0, drive.duration_s, 0.01)
    all_tracks = tracks(scenario, drive)
    assert len(all_tracks) == 6
    for track in all_tracks:
        poses, walked = track.at(times, drive.at(times))
        is_there = np.isfinite(poses[:, 0])
        assert 0.5 < is_there.mean() < 1.0
        assert np.abs(poses[is_there, 1] - 2.0).max() <= 1.0 + 1e-9
        together = is_there[1:] & is_there[:-1]
        speeds = np.diff(poses[:, 0])[together] / 0.01
        assert speeds.min() > 0.85 - 1e-6
        assert speeds.max() < 1.15 + 1e-6
        assert (np.diff(walked) >= 0.0).all()


def test_a_stream_keeps_its_width_around_corners():
    stream = {"does": "stream", "path": [[0, 0], [9, 0], [9, 9]], "count": 20, "width_m": 2.0}
    scenario = parse_scenario(room(movers=[stream], robot={"path": [[0, 50], [40, 50]]}))
    drive = plan_drive(scenario.robot)
    times = np.arange(0.0, drive.duration_s, 0.1)
    poses = np.concatenate([track.at(times, drive.at(times))[0] for track in tracks(scenario, drive)])
    x, y = poses[np.isfinite(poses[:, 0]), :2].T
    away = np.minimum(np.abs(y) + np.maximum(x - 10.0, 0.0), np.abs(x - 9.0) + np.maximum(-1.0 - y, 0.0))
    assert away.max() <= 1.0 + 1e-9


def test_companions_stay_around_the_robot():
    group = {"does": "accompany", "count": 12, "reach_m": 2.0}
    scenario = parse_scenario(room(movers=[group]))
    drive = plan_drive(scenario.robot)
    times = np.arange(0.0, drive.duration_s, 0.1)
    robot = drive.at(times)
    offsets = np.stack([track.at(times, robot)[0][:, :2] - robot[:, :2] for track in tracks(scenario, drive)])
    away = np.linalg.norm(offsets, axis=2)
    assert offsets.shape[0] == 12
    assert away.min() > 0.45
    assert away.max() < 2.25
    assert np.linalg.norm(np.diff(offsets, axis=1), axis=2).max() < 0.5
    bearings = np.arctan2(offsets[:, 0, 1], offsets[:, 0, 0])
    assert np.ptp(bearings) > np.pi


@pytest.mark.parametrize("when", ["near", "away"])
def test_changes_wait_for_the_robot_to_be_near_or_away(when):
    box = {
        "name": "box",
        "size_m": [1, 1],
        "places": {"a": [0, 3, 0]},
        "process": {"mean_s": 2, "when": when, "near_m": 6},
    }
    run = simulate(
        parse_scenario({"world": {"boxes": [box]}, "robot": {"path": [[0, 0], [20, 0]], "repeat": 4}})
    )
    history, drive = run.objects[0], plan_drive(expand(run.scenario).robot)
    assert history.times_s.size > 3
    assert all(before != after for before, after in pairwise(history.states.tolist()))
    away = np.linalg.norm(drive.at(history.times_s[1:])[:, :2] - [0, 3], axis=1)
    assert (away < 6).all() if when == "near" else (away >= 6).all()


def distorted(**changes):
    path = [[0, 0], [6, 0], {"to": [2, 0], "backwards": True}, [2, 4], {"to": [6, 4], "wait_s": 2}]
    return simulate(parse_scenario({"robot": {"path": path}, "odometry": {**EXACT, **changes}, "seed": 2}))


def test_scales_bias_and_lost_sign_do_what_they_say():
    true = distorted()
    steps = between(true.log.odometry[:-1], true.log.odometry[1:])
    scaled = distorted(translation_scale=1.1, rotation_scale=0.9)
    got = between(scaled.log.odometry[:-1], scaled.log.odometry[1:])
    np.testing.assert_allclose(got[:, 2], 0.9 * steps[:, 2], atol=1e-9)
    np.testing.assert_allclose(np.hypot(*got[:, :2].T), 1.1 * np.hypot(*steps[:, :2].T), atol=1e-3)
    biased = distorted(bias_degpm=2.0)
    got = between(biased.log.odometry[:-1], biased.log.odometry[1:])
    assert abs(math.degrees((got - steps)[:, 2].sum()) - 2.0 * np.hypot(*steps[:, :2].T).sum()) < 1.0
    unsigned = distorted(signed=False)
    got = between(unsigned.log.odometry[:-1], unsigned.log.odometry[1:])
    assert (steps[:, 0] < -1e-3).any()
    assert (got[:, 0] > -1e-3).all()


def test_lag_freezes_slips_and_noise_do_what_they_say():
    true = distorted()
    late = distorted(lag_s=0.5)
    times = (true.log.stamps_ns - true.log.stamps_ns[0]) * 1e-9
    np.testing.assert_allclose(
        late.log.odometry[times > 0.55][:, 0],
        np.interp(times[times > 0.55] - 0.5, times, true.log.odometry[:, 0]),
        atol=0.02,
    )
    stuck = distorted(freezes_per_hour=600, freeze_s=2.0)
    still = (np.abs(between(stuck.log.odometry[:-1], stuck.log.odometry[1:])) < 1e-12).all(axis=1)
    assert (
        still.sum()
        > (np.abs(between(true.log.odometry[:-1], true.log.odometry[1:])) < 1e-12).all(axis=1).sum() + 15
    )
    slipping = distorted(slips_per_100m=100, slip_deg=20)
    jumps = np.abs(between(slipping.log.odometry[:-1], slipping.log.odometry[1:])[:, 2])
    assert (jumps > math.radians(5) + 0.1).any()
    noisy = distorted(sigma_m_per_sqrt_m=0.05, sigma_deg_per_sqrt_m=2.0)
    assert np.abs(between(noisy.log.odometry, true.log.odometry)[-1]).max() > 0.01


def test_no_odometry_is_rows_of_nan():
    run = simulate(parse_scenario({"robot": {"path": [[0, 0], [1, 0]]}, "odometry": None}))
    assert not run.log.has_odometry.any()
    assert run.odometry.stamps_ns.size == 0
    assert replace(run.log).n_scans == run.log.n_scans
