"""Local maps: kernels against plain twins, and what fitting one on another has to do."""

import numpy as np
import pytest

from dynmap_cli.counting.counts import rays_of
from dynmap_cli.domain.poses import between, compose, transform_points
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.kernels.local_maps import (
    CELL_M,
    COARSE,
    COARSE_M,
    COARSE_MASK,
    FREE_CELL_M,
    FREE_SIDE,
    REACH,
    SIZE,
    draw_local_map,
)
from dynmap_cli.kernels.map_fits import judge_fit, search_coarse
from dynmap_cli.mapping.local_maps import Easel, LocalMap, make_local_maps
from dynmap_cli.scan_matching.sweeps import sweeps_of
from tests.reference.mapping import plain_coarse_field, plain_judge, plain_local_map, plain_normal

WALLS = np.array(
    [
        [[-4.0, -3.0], [5.0, -3.0]],
        [[5.0, -3.0], [5.0, 2.0]],
        [[5.0, 2.0], [3.0, 4.0]],
        [[3.0, 4.0], [-4.0, 4.0]],
        [[-4.0, 4.0], [-4.0, -3.0]],
        [[1.0, 0.5], [2.0, 1.0]],
        [[-2.0, -1.0], [-2.0, 0.5]],
    ]
)


def cast(pose, bearings):
    """Ranges to the walls from a pose, by plain line intersection."""
    angles = pose[2] + bearings
    ranges = np.full(bearings.size, np.inf)
    for a, b in WALLS:
        edge = b - a
        for k, angle in enumerate(angles):
            d = np.array([np.cos(angle), np.sin(angle)])
            det = d[0] * -edge[1] + d[1] * edge[0]
            if abs(det) < 1e-12:
                continue
            r = a - pose[:2]
            t = (r[0] * -edge[1] + r[1] * edge[0]) / det
            u = (d[0] * r[1] - d[1] * r[0]) / det
            if t > 0 and 0 <= u <= 1:
                ranges[k] = min(ranges[k], t)
    return ranges


@pytest.fixture(scope="module")
def world():
    """Seventeen scans along a short path in a room; the log, its poses and the one local map of all of them."""
    rng = np.random.default_rng(2)
    bearings = np.linspace(-np.pi, np.pi, 240, endpoint=False)
    poses = np.column_stack([np.linspace(-1.0, 1.0, 17), np.zeros(17), np.linspace(-0.3, 0.3, 17)])
    ranges = np.array([cast(pose, bearings) for pose in poses]) + rng.normal(0, 0.005, (17, 240))
    log = single_laser_log(
        np.arange(17) * 10**8, ranges.astype(np.float32), bearings, poses, range_limits_m=(0.05, 20.0)
    )
    sweeps = sweeps_of(log, None)
    maps = make_local_maps(sweeps, rays_of(log, 20.0), np.zeros((17, 3)), np.arange(17), poses)
    return log, poses, maps


def test_a_local_map_has_the_centroids_and_normals_of_the_plain_one(world):
    log, poses, maps = world
    first = maps[0]
    members = range(max(first.anchor - 8, 0), min(first.anchor + 9, 17))
    seen = []
    for scan in members:
        ranges = log.ranges_m[scan].astype(float)
        local = ranges[:, None] * np.column_stack([np.cos(log.bearings_rad[0]), np.sin(log.bearings_rad[0])])
        kept = [local[0]]
        for point in local[1:]:
            if np.hypot(*(point - kept[-1])) >= 0.03:
                kept.append(point)
        seen.append(transform_points(between(poses[first.anchor], poses[scan]), np.array(kept)))
    points = np.concatenate(seen)
    cells = plain_local_map(points, np.ones(len(points)), CELL_M)
    assert abs(len(cells) - first.points.shape[0]) <= 2
    agree = 0
    for (x, y), normal in zip(first.points, first.normals, strict=True):
        key = int(np.floor(y / CELL_M)), int(np.floor(x / CELL_M))
        if key not in cells:
            continue
        plain = plain_normal(cells, key, CELL_M)
        if plain is None:
            agree += not normal.any()
        else:
            agree += abs(abs(float(plain @ normal)) - 1.0) < 1e-3
            agree -= bool(normal @ (x, y) > 0)  # the room is seen from within
    assert agree > 0.98 * first.points.shape[0]


def test_no_free_cell_touches_a_point_and_the_way_is_free(world):
    _, poses, maps = world
    half = FREE_SIDE // 2
    for local_map in maps:
        cells = np.floor(local_map.points / FREE_CELL_M).astype(int) + half
        for dr in (-1, 0, 1):
            for dc in (-1, 0, 1):
                assert not local_map.free[cells[:, 1] + dr, cells[:, 0] + dc].any()
        way = np.floor(between(poses[local_map.anchor], poses)[:, :2] / FREE_CELL_M).astype(int) + half
        assert local_map.free[way[:, 1], way[:, 0]].all()


def test_each_cell_of_a_drawn_map_notes_the_point_nearest_to_its_centre(world):
    _, _, maps = world
    points = maps[0].points
    index = np.full((SIZE, SIZE), -1, dtype=np.int32)
    field, coarse = np.zeros((SIZE, SIZE), np.uint8), np.zeros((COARSE, COARSE), np.uint8)
    draw_local_map(points, len(points), 1, index, field, coarse)
    cells = np.floor(points / CELL_M).astype(int)
    for row in range(-120, 120):
        for col in range(-120, 120):
            near = np.flatnonzero(np.abs(cells - (col, row)).max(axis=1) <= REACH)
            noted = index[row % SIZE, col % SIZE]
            if near.size == 0:
                assert noted == -1
            else:
                distances = np.linalg.norm(points[near] - (np.array([col, row]) + 0.5) * CELL_M, axis=1)
                assert np.linalg.norm(points[noted] - (np.array([col, row]) + 0.5) * CELL_M) == pytest.approx(
                    distances.min(), abs=1e-6
                )


def test_drawing_then_wiping_leaves_the_easel_blank(world):
    _, _, maps = world
    points = maps[0].points
    index = np.full((SIZE, SIZE), -1, dtype=np.int32)
    field, coarse = np.zeros((SIZE, SIZE), np.uint8), np.zeros((COARSE, COARSE), np.uint8)
    draw_local_map(points, len(points), 1, index, field, coarse)
    assert (index >= 0).any()
    draw_local_map(points, len(points), 0, index, field, coarse)
    assert (index == -1).all()
    assert not field.any()
    assert not coarse.any()


def test_coarse_search_finds_what_trying_everything_finds(world):
    _, _, maps = world
    points = maps[0].points
    index = np.full((SIZE, SIZE), -1, dtype=np.int32)
    field, coarse = np.zeros((SIZE, SIZE), np.uint8), np.zeros((COARSE, COARSE), np.uint8)
    draw_local_map(points, len(points), 1, index, field, coarse)
    plain = plain_coarse_field(points, COARSE_M)
    for (row, col), value in plain.items():
        assert coarse[row & COARSE_MASK, col & COARSE_MASK] == value
    moved = points[::9].copy()
    guess, out = np.array([0.5, -0.3, 0.09]), np.zeros((4, 4))
    count = search_coarse(moved, len(moved), guess, 0.12, 4, coarse, np.zeros((64, 64), np.int32), out)
    used = moved[:: max(1, len(moved) // 150)]
    best = (-1.0, None)
    for a in range(-4, 5):
        yaw = guess[2] + 0.03 * a
        turned = transform_points(np.array([guess[0], guess[1], yaw]), used.astype(float))
        cells = np.floor(turned / COARSE_M).astype(int)
        for i in range(-4, 5):
            for j in range(-4, 5):
                score = sum(plain.get((row + i, col + j), 0) for col, row in cells) / (255 * len(used))
                if score > best[0] + 1e-12:
                    best = (score, (guess[0] + j * COARSE_M, guess[1] + i * COARSE_M, yaw))
    assert count >= 1
    np.testing.assert_allclose(out[0, 3], best[0], atol=0.02)
    np.testing.assert_allclose(out[0, :2], best[1][:2], atol=COARSE_M + 1e-9)
    assert (np.diff(out[:count, 3]) <= 0).all()


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.06, -0.04, 0.02), (0.4, 0.7, -0.2), (3.0, 0.0, 0.0)])
def test_judged_shares_match_the_plain_count(world, offset):
    _, _, maps = world
    a, b = maps[0], maps[-1]
    index = np.full((SIZE, SIZE), -1, dtype=np.int32)
    field, coarse = np.zeros((SIZE, SIZE), np.uint8), np.zeros((COARSE, COARSE), np.uint8)
    draw_local_map(a.points, len(a.points), 1, index, field, coarse)
    points, normals, out = b.points[::5].copy(), b.normals[::5].copy(), np.zeros(3)
    judge_fit(points, normals, len(points), a.points, a.normals, a.free, index, np.array(offset), 1, out)
    expected = plain_judge(points, normals, offset, a.points, a.normals, a.free, CELL_M, FREE_CELL_M)
    np.testing.assert_allclose(out, expected, atol=0.01)


def test_a_map_finds_its_place_on_another_of_the_same_room(world):
    _, poses, maps = world
    true = between(poses[maps[0].anchor], poses[maps[-1].anchor])
    easel = Easel()
    easel.draw(maps[0])
    best = easel.search(maps[-1], compose(true, np.array([0.6, -0.5, 0.2])), 1.0, 0.3)[0]
    error = between(true, best.pose)
    assert np.hypot(*error[:2]) < 0.005
    assert abs(error[2]) < 0.001
    assert best.matched_of_seen > 0.9
    assert best.in_free < 0.05


def test_a_map_put_in_the_wrong_place_lies_in_free_space(world):
    _, poses, maps = world
    true = between(poses[maps[0].anchor], poses[maps[-1].anchor])
    easel = Easel()
    easel.draw(maps[0])
    wrong = easel.judge(maps[-1], compose(true, np.array([0.8, 0.6, 0.3])))
    assert wrong.in_free > 0.25


def corridor_map():
    """A bare corridor 2 m wide, seen from its middle."""
    x = np.arange(-6.0, 6.0, CELL_M) + CELL_M / 2
    walls = [np.column_stack([x, np.full(x.size, side)]) for side in (-1.0, 1.0)]
    normals = [np.tile([0.0, -side], (x.size, 1)) for side in (-1.0, 1.0)]
    free = np.zeros((FREE_SIDE, FREE_SIDE), dtype=np.uint8)
    free[FREE_SIDE // 2 - 8 : FREE_SIDE // 2 + 8] = 1
    points, normals = (np.concatenate(part).astype(np.float32) for part in (walls, normals))
    return LocalMap(0, points, normals, np.packbits(free, axis=1))


@pytest.mark.parametrize("turn", [0.0, np.pi])
def test_a_corridor_does_not_match_on_the_other_side_of_its_wall(turn):
    easel = Easel()
    easel.draw(corridor_map())
    here = easel.judge(corridor_map(), np.array([0.0, 0.0, turn]))
    beside = easel.judge(corridor_map(), np.array([0.0, 2.0, turn]))
    assert here.matched == here.seen == 1.0
    assert beside.matched == beside.seen == beside.in_free == 0.0
