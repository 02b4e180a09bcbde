"""What scans say about states, and the law that the filter is Bayes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet
from dynmap_cli.domain.scans import single_laser_log
from dynmap_cli.errors import ArtifactError
from dynmap_cli.localization.beliefs.states import entropy_bits, place_sweep, state_evidence, update_belief
from dynmap_cli.localization.beliefs.transitions import predict_belief
from dynmap_cli.localization.beliefs.world import World
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import Sweep, pose_ends, scan_log_likelihoods, sweep_of, temper
from dynmap_cli.localization.sensing.surfaces import FROM_ALL_SIDES, surface_codes
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.tracking import localize_log
from tests.reference.localization import exact_state_posterior

RESOLUTION_M = 0.1
BEARINGS = np.radians(np.arange(-90.0, 91.0, 2.0))
POSE = np.array([2.05, 2.55, 0.0])


def room(shut):
    """A room of 4 m x 5 m with a second one behind a door at x = 4 m, y 2 to 3 m."""
    cells = np.full((52, 82), FREE, dtype=np.int8)
    cells[[0, -1], :] = OCCUPIED
    cells[:, [0, -1]] = OCCUPIED
    cells[:, 41] = OCCUPIED
    if not shut:
        cells[21:31, 41] = FREE
    return cells


def world(with_unknown=False):
    frame = GridFrame(RESOLUTION_M, -0.1, -0.1, 52, 82)
    inner = frame.window(19, 39, 14, 5)
    values = []
    for shut in (True, False):
        cut = room(shut)[19:33, 39:44]
        values.append(np.where(cut == OCCUPIED, 0.98, 0.02).astype(np.float32))
    if with_unknown:
        values[1][:] = np.nan
    patches = tuple(Patch(k + 5, 3, v) for k, v in enumerate(values))
    return OccupancyGrid(frame, room(shut=True)), PatchSet(7, inner, values[0] > 0.5, patches, 0.8)


def ranges_in(shut, pose=POSE, noise_m=0.0, seed=0):
    """Distances in that world, found by walking; the surface of a wall is the middle of its cell."""
    cells, steps = room(shut), np.arange(0.0, 12.0, 0.01)
    x = pose[0] + steps[:, None] * np.cos(BEARINGS + pose[2])
    y = pose[1] + steps[:, None] * np.sin(BEARINGS + pose[2])
    row = np.clip(np.floor((y + 0.1) / RESOLUTION_M), 0, 51).astype(int)
    col = np.clip(np.floor((x + 0.1) / RESOLUTION_M), 0, 81).astype(int)
    first = np.argmax(cells[row, col] == OCCUPIED, axis=0)
    return (steps[first] + 0.05 + noise_m * np.random.default_rng(seed).normal(size=BEARINGS.size)).astype(
        np.float32
    )


def log_of(states, seconds=0.5):
    """A robot that stands and watches the door."""
    n = len(states)
    return single_laser_log(
        np.arange(n, dtype=np.int64) * int(seconds * 1e9),
        np.stack([ranges_in(shut, noise_m=0.03, seed=k) for k, shut in enumerate(states)]),
        BEARINGS,
        np.zeros((n, 3)),
    )


def evidence(shut, settings, pool, pose=POSE):
    sweep = sweep_of(log_of([shut]), 0, 30.0)
    return state_evidence(place_sweep(sweep, pose), pool, pool.submaps[0], settings)


@pytest.mark.parametrize("shut", [True, False])
def test_the_right_state_is_told_from_one_scan(shut):
    settings = LocalizationSettings()
    grid, patch_set = world()
    said = evidence(shut, settings, make_map_pool(grid, [patch_set], settings))
    assert np.argmax(said.log_likelihoods) == (0 if shut else 1)
    assert said.n_beams > 5


def test_the_ends_alone_cannot_see_that_a_door_opened_but_the_crossings_can():
    settings = LocalizationSettings()
    grid, patch_set = world()
    said = evidence(False, settings, make_map_pool(grid, [patch_set], settings))
    assert abs(said.at_ends[0] - said.at_ends[1]) < 1.0
    assert said.through[0] < said.through[1] - 10.0


def test_who_looks_through_what_lets_beams_pass_learns_less_than_who_looks_through_a_door():
    settings = LocalizationSettings()
    said = []
    for solid in (0.98, 0.4):
        grid, patch_set = world()
        pane = patch_set.patches[0]
        values = np.where(pane.reflectance > 0.5, solid, pane.reflectance).astype(np.float32)
        panes = replace(patch_set, patches=(replace(pane, reflectance=values), *patch_set.patches[1:]))
        said.append(evidence(False, settings, make_map_pool(grid, [panes], settings)).through[0])
    n_beams = round(said[1] / math.log(0.6 + 0.4 / 31.0))
    assert n_beams > 5
    assert said[0] < 4.0 * said[1] < 0.0


def test_what_a_state_does_not_know_tells_it_from_no_other():
    settings = LocalizationSettings()
    grid, patch_set = world(with_unknown=True)
    for shut in (True, False):
        said = evidence(shut, settings, make_map_pool(grid, [patch_set], settings))
        np.testing.assert_allclose(said.log_likelihoods[0], said.log_likelihoods[1])
        assert said.n_beams == 0


def test_beams_that_cross_the_rectangle_beside_what_differs_do_not_bring_it_into_view():
    settings = LocalizationSettings()
    grid, patch_set = world()
    pool = make_map_pool(grid, [patch_set], settings)
    pose = np.array([3.85, 0.5, 0.0])
    sweep = sweep_of(log_of([True]), 0, 30.0)
    along = np.degrees(sweep.directions_rad) > 80.0
    ends = Sweep(sweep.sensor, sweep.directions_rad[along], np.full(along.sum(), 4.3), 30.0)
    said = state_evidence(place_sweep(ends, pose), pool, pool.submaps[0], settings)
    assert said.n_beams == 0


def test_a_person_in_front_of_the_door_says_nothing():
    settings = LocalizationSettings()
    grid, patch_set = world()
    pool = make_map_pool(grid, [patch_set], settings)
    log = single_laser_log(
        np.zeros(1, dtype=np.int64), np.minimum(ranges_in(False), 1.0)[None, :], BEARINGS, np.zeros((1, 3))
    )
    said = state_evidence(place_sweep(sweep_of(log, 0, 30.0), POSE), pool, pool.submaps[0], settings)
    assert said.n_beams == 0
    np.testing.assert_allclose(said.log_likelihoods[0], said.log_likelihoods[1])


def still(**more):
    """Settings under which every particle stays where it is."""
    values = {
        "start": tuple(POSE),
        "start_sigma_m": 1e-9,
        "start_sigma_rad": 1e-9,
        **{f"alpha{k}": 0.0 for k in range(1, 5)},
        "drift_sigma_m": 0.0,
        "drift_sigma_rad": 0.0,
        "update_max_s": 0.0,
        "independent_beams": 1.0,
        **more,
    }
    return LocalizationSettings(**values)


STATES = [True, True, False, True, False, False, False]


def scan_likelihoods(log, pool, settings):
    """Tempered log-likelihood of every scan in every state, at the known pose."""
    table, submap = [], pool.submaps[0]
    for scan in range(log.n_scans):
        sweep = sweep_of(log, scan, settings.laser_max_range)
        said = state_evidence(place_sweep(sweep, POSE), pool, submap, settings)
        exponent = temper(sweep.ranges_m.size, settings)
        if settings.states == "belief":
            table.append(exponent * said.log_likelihoods)
        else:
            ends = pose_ends(sweep, settings.max_beams)
            poses = np.repeat(POSE[None, :], submap.n_states, axis=0)
            fields = scan_log_likelihoods(pool.pool, pool.frame, poses, ends, submap.windows())
            table.append(temper(ends.shape[0], settings) * fields + exponent * said.through)
    return table


@pytest.mark.parametrize(("states", "tolerance"), [("belief", 1e-6), ("sampled", 0.03)])
def test_the_posterior_over_states_is_that_of_bayes_by_enumeration(states, tolerance):
    settings = still(states=states, min_particles=5000, max_particles=5000)
    grid, patch_set = world()
    log, pool = log_of(STATES), make_map_pool(grid, [patch_set], settings)
    stays = [0.0] + [float(predict_belief(np.eye(2)[0], pool.submaps[0], 0.5)[0])] * (len(STATES) - 1)
    table = scan_likelihoods(log, pool, settings)
    found = localize_log(log, pool, settings, seed=1)
    assert len(found.states) == len(STATES)
    for t, row in enumerate(found.states):
        exact = exact_state_posterior([0.5, 0.5], stays[: t + 1], table[: t + 1])
        np.testing.assert_allclose(row.belief, exact, atol=tolerance)
    assert found.states[1].belief[0] > 0.6 and found.states[-1].belief[1] > 0.6


def test_belief_and_entropy():
    np.testing.assert_allclose(update_belief(np.array([0.5, 0.5]), np.log([0.2, 0.6])), [0.25, 0.75])
    np.testing.assert_allclose(update_belief(np.array([0.0, 1.0]), np.array([0.0, -5000.0])), [0.0, 1.0])
    assert entropy_bits(np.array([0.5, 0.5])) == 1.0
    assert entropy_bits(np.array([1.0, 0.0])) == 0.0


def test_painting_a_sure_belief_shows_the_state_and_touches_nothing_else():
    settings = LocalizationSettings()
    grid, patch_set = world()
    pool = make_map_pool(grid, [patch_set], settings)
    before = pool.pool.copy()
    pool.paint(0, np.array([0.0, 1.0]))
    field = pool.pool[: pool.frame.rows * pool.frame.cols].reshape(pool.frame.shape)
    area = pool.submaps[0]
    window = field[area.row : area.row + area.frame.rows, area.col : area.col + area.frame.cols]
    np.testing.assert_allclose(window, np.log(area.likelihoods[1]), rtol=1e-5)
    assert area.owned.all()
    changed = (before != pool.pool)[: field.size].reshape(field.shape)
    changed[area.row : area.row + area.frame.rows, area.col : area.col + area.frame.cols] = False
    assert not changed.any()


def test_surfaces_know_their_direction():
    solid = np.zeros((30, 30), dtype=bool)
    solid[5, 3:25] = True
    solid[8:28, 27] = True
    for k in range(10):
        solid[10 + k, 5 + k] = True
    solid[25, 5] = True
    codes = surface_codes(solid)
    assert codes[5, 14] == 1
    assert codes[18, 27] == 91
    assert codes[15, 10] == 46
    assert codes[25, 5] == FROM_ALL_SIDES
    assert (codes[~solid] == 0).all()


def test_patches_on_other_cells_than_the_map_are_refused():
    grid, patch_set = world()
    frame = GridFrame(0.05, 3.8, 1.8, *patch_set.frame.shape)
    other = PatchSet(7, frame, patch_set.varying, patch_set.patches, 0.8)
    with pytest.raises(ArtifactError, match="other cells"):
        make_map_pool(grid, [other], LocalizationSettings())


def test_a_rectangle_may_reach_beyond_the_map():
    grid, patch_set = world()
    frame = grid.frame.window(-3, 70, 14, 20)
    values = np.full(frame.shape, 0.9, dtype=np.float32)
    beyond = PatchSet(1, frame, values > 0, (Patch(0, 1, values),), math.nan)
    pool = make_map_pool(grid, [patch_set, beyond], LocalizationSettings())
    assert pool.frame.rows == 52 + 3 + 2 * 10 and pool.frame.cols == 90 + 2 * 10


def test_cells_that_no_state_knows_are_those_of_the_map():
    settings = LocalizationSettings()
    grid, patch_set = world()
    patches = []
    for patch in patch_set.patches:
        values = patch.reflectance.copy()
        values[:, :2] = np.nan
        patches.append(Patch(patch.patch_id, patch.support, values))
    partly = PatchSet(7, patch_set.frame, patch_set.varying, tuple(patches), 0.8)
    pool = make_map_pool(grid, [partly], settings)
    assert not pool.submaps[0].owned[:, :2].any()
    assert pool.submaps[0].owned[:, 2:].all()


def test_outside_the_map_nothing_is_near_even_where_a_wall_is_its_edge():
    settings = LocalizationSettings()
    grid, patch_set = world()
    pool = make_map_pool(grid, [patch_set], settings)
    ends = np.array([[-50.0, 0.0], [2.5, -1.3], [2.5, -0.12]])
    for field in (pool.pool, pool.start_field):
        values = [scan_log_likelihoods(field, pool.frame, np.zeros((1, 3)), end[None, :])[0] for end in ends]
        assert abs(values[0] - math.log(0.5 / 30)) < 1e-5
        assert abs(values[1] - math.log(0.5 / 30)) < 1e-5
        assert values[2] > -1.2


@pytest.mark.parametrize(
    ("kind", "hour", "belief"), [("uniform", 9, 0.5), ("support", 9, 0.5), ("hour", 9, 0.1), ("hour", 3, 0.9)]
)
def test_before_the_first_look_the_prior_is_believed(kind, hour, belief):
    grid, patch_set = world()
    shut = tuple(0.1 if 8 <= at < 18 else 0.9 for at in range(24))
    opened = tuple(round(1.0 - share, 6) for share in shut)
    patches = [
        replace(patch, share_by_hour=by) for patch, by in zip(patch_set.patches, (shut, opened), strict=True)
    ]
    settings = LocalizationSettings(prior=kind)
    believed = World(make_map_pool(grid, [replace(patch_set, patches=tuple(patches))], settings))
    stamp_ns = (20_000 * 24 + hour) * 3600 * 10**9
    assert believed.belief(0, stamp_ns)[0] == pytest.approx(belief, abs=2e-3)
    believed.learn(0, stamp_ns, np.array([0.3, 0.7]))
    assert believed.belief(0, stamp_ns)[0] == pytest.approx(0.3)
