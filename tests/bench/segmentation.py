"""Sub-maps against what visibly changed, and the paper's two experiments with states, in numbers."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynmap_cli.arrays import F64
from dynmap_cli.domain.poses import inverse, transform_points
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.evaluation.states import LearnedStates, read_learned_states, score_states
from dynmap_cli.evaluation.truth import read_run, same_scans
from dynmap_cli.files.counting_map import read_counting_map
from dynmap_cli.segmentation.finding import region_params
from dynmap_cli.segmentation.regions import grow_components, merge_regions
from dynmap_cli.segmentation.settings import SegmentationSettings
from tests.bench.measured import stage_seconds
from tests.bench.tables import Row, Table, number, percent
from tests.bench.visible import visible_changes
from tests.bench.worlds import Bench, truth_of

_CELL_M = 0.05
_LENGTHS = {30: (9, 6), 90: (27, 4)}
"""Minutes: visits without a pause between them, and seeds."""
_BOUNDS = {30: (0.95, 2.0), 90: (0.97, 1.0)}
"""Least share found, most sub-maps without cause per 1000 m2."""
_EXPERIMENTS = {
    "three_doors": "three doors (Fig. 1.11)",
    "box_at_three_places": "a box at three places (Fig. 1.12)",
}


@dataclass(frozen=True, slots=True)
class Found:
    """What one recording gave.

    Attributes
    ----------
    often, once : tuple of int
        Objects that visibly changed by two windows of either kind, and by one; and those of them in a sub-map.
    submaps, without_cause, over_cap : int
    area_m2 : float
        Of the map.
    segment_s : float
    """

    often: tuple[int, int]
    once: tuple[int, int]
    submaps: int
    without_cause: int
    over_cap: int
    area_m2: float
    segment_s: float


def office(seed: int, visits: int) -> dict[str, Any]:
    """An office with doors and boxes that change, walkers and groups that stand, turned against the map's axes."""
    changes = {"mean_s": 300, "when": "away"}
    return {
        "seed": seed,
        "turn_deg": 17.0 * seed % 90.0,
        "generate": {"kind": "office", "boxes": 6, "people": 3, "talking": 2, "changes": changes},
        "robot": {"repeat": visits, "speed_mps": 0.7},
        "lasers": [{"beams": 271, "fov_deg": 270, "max_range_m": 25, "rate_hz": 5, "dropout_share": 0.005}],
    }


def judge(bench: Bench, minutes: int, seed: int) -> Found:
    """Simulate, build, compare with the truth."""
    name = f"office-{minutes}-min-seed-{seed}"
    recording = bench.simulated(name, office(seed, _LENGTHS[minutes][0]))
    run_dir, _ = bench.built(name, recording)
    truth, run = truth_of(recording), read_run(run_dir)
    mine, theirs = same_scans(run.log.stamps_ns, truth)
    if mine.size != truth.trajectory.stamps_ns.size or (mine != theirs).any():
        msg = f"{name}: scans are missing in the run"
        raise ValueError(msg)
    learned = read_learned_states(run_dir, truth)
    changes = visible_changes(run.log.select(mine), truth)
    often = [one.often_m for one in changes if one.is_seen_often]
    once = [one.once_m for one in changes if one.is_seen_once]
    cap = SegmentationSettings().max_area_m2
    counts = read_counting_map(run_dir / "map" / "reflectance.npz")
    return Found(
        (len(often), sum(_is_in_submap(cells, learned) for cells in often)),
        (len(once), sum(_is_in_submap(cells, learned) for cells in once)),
        len(learned.submaps),
        sum(not learned.reach[submap.submap_id] for submap in learned.submaps),
        sum(submap.area_m2 > cap for submap in learned.submaps),
        float(np.isfinite(counts.reflectance).sum()) * counts.frame.resolution_m**2,
        stage_seconds(run_dir)["segment"],
    )


def _is_in_submap(cells_m: F64, learned: LearnedStates) -> bool:
    """Whether one sub-map holds half or more of some cells, given in the frame of the truth."""
    places = transform_points(inverse(learned.truth_from_map), cells_m)
    return any(_is_inside(places, submap).mean() >= 0.5 for submap in learned.submaps)


def _is_inside(places: F64, submap: SubMap) -> F64:
    distance = np.abs(places - np.array(submap.center_m))
    return np.asarray((distance <= np.array(submap.size_m) / 2.0).all(axis=1), dtype=np.float64)


def tables(bench: Bench) -> list[Table]:
    """The long table: worlds drawn from seeds."""
    seeds = {minutes: range(1, 2 if bench.quick else 1 + count) for minutes, (_, count) in _LENGTHS.items()}
    jobs = {
        minutes: [bench.jobs.start(judge, bench, minutes, seed) for seed in seeds[minutes]]
        for minutes in _LENGTHS
    }
    table = Table(
        "Sub-maps",
        [
            "Offices drawn from seeds, each turned by another angle: doors and boxes that change while the robot is "
            "away, people who walk, groups that stand and talk; `dynmap build` with default settings. An object "
            "changed visibly if at least 6 cells of 5 cm were seen with it and without it, within 12 m, in two "
            "windows of 30 s each (beside it: in one window each); this is found from the truth, by none of the "
            "program's rules. It is found if a sub-map holds half of these cells. A sub-map is without cause if no "
            "door or box reaches into it; m2 are those of the map that is known. Bounds: 95 % and 2 per 1000 m2 at 30 "
            "minutes, 97 % and 1 at 90, none over the cap; what misses one is **bold**.",
        ],
        [
            "minutes",
            "seeds",
            "changed visibly",
            "found",
            "by one window",
            "found",
            "sub-maps",
            "without cause",
            "per 1000 m2",
            "over the cap",
            "CPU s, segment",
        ],
    )
    for minutes in _LENGTHS:
        table.add(f"{minutes}", lambda minutes=minutes: _row(minutes, jobs[minutes]))
        table.remark(
            f"sub-maps, {minutes} minutes of office",
            lambda minutes=minutes: _short(_row(minutes, jobs[minutes])),
        )
    return [table, _cost_table(bench)]


def _cost_table(bench: Bench) -> Table:
    """Seconds against the number of contested cells: the map grows, what stands on a square metre does not."""
    table = Table(
        "Growing and merging regions against contested cells",
        [
            "Boxes of 3 x 3 to 8 x 8 contested cells at random places, 4 on each 100 m2 of a map that grows; CPU "
            "seconds of growing, cutting and merging, the best of three. The last column stays about the same where "
            "the cost is O(p log p).",
        ],
        ["boxes", "contested cells p", "components", "regions", "CPU s", "us per p log2 p"],
    )
    for count in (100, 400, 1600) if bench.quick else (100, 400, 1600, 6400, 25600):
        table.add(f"{count}", lambda count=count: _regions_row(count))
    return table


def _regions_row(count: int) -> Row:
    draw = np.random.default_rng(count)
    edge = math.ceil(math.sqrt(count / 4.0) * 10.0 / _CELL_M)
    contested = np.zeros((edge, edge), dtype=bool)
    for row, col, height, width in draw.integers([0, 0, 3, 3], [edge, edge, 9, 9], size=(count, 4)).tolist():
        contested[row : row + height, col : col + width] = True
    settings = SegmentationSettings()
    params = region_params(settings, _CELL_M)
    standing = np.zeros(contested.shape, dtype=np.int8)
    seconds = []
    for _ in range(3):
        started = time.process_time()
        components = grow_components(contested, params)
        groups = merge_regions(components, standing, params)
        seconds.append(time.process_time() - started)
    cells, best = int(contested.sum()), min(seconds)
    per_cell = 1e6 * best / (cells * math.log2(cells))
    return [f"{cells}", f"{len(components)}", f"{len(groups)}", number(best), number(per_cell)]


def _row(minutes: int, jobs: list[Future[Found]]) -> Row:
    results = [job.result() for job in jobs]

    def total(value: Callable[[Found], float]) -> float:
        return sum(value(one) for one in results)

    (least, most), often = _BOUNDS[minutes], total(lambda one: one.often[0])
    share = total(lambda one: one.often[1]) / often
    once = total(lambda one: one.once[0])
    without, over = total(lambda one: one.without_cause), total(lambda one: one.over_cap)
    per_area = 1000.0 * without / total(lambda one: one.area_m2)
    return [
        f"{len(results)}",
        f"{often:.0f}",
        _judged(percent(share), share >= least),
        f"{once:.0f}",
        percent(total(lambda one: one.once[1]) / once),
        f"{total(lambda one: one.submaps):.0f}",
        f"{without:.0f}",
        _judged(number(per_area, 2), per_area <= most),
        _judged(f"{over:.0f}", over == 0),
        number(total(lambda one: one.segment_s) / len(results), 2),
    ]


def _judged(text: str, is_kept: bool) -> str:
    return text if is_kept else f"**{text}**"


def _short(row: Row) -> str:
    return f"{row[2]} of {row[1]} visible changes found, {row[7]} sub-maps without cause per 1000 m2"


def experiment_tables(bench: Bench) -> list[Table]:
    """The short table: what the paper shows in Fig. 1.11 and 1.12."""
    jobs = {
        (world, seed): bench.jobs.start(_experiment, bench, world, seed)
        for world in _EXPERIMENTS
        for seed in bench.seeds
    }
    table = Table(
        "The paper's experiments with states",
        [
            "An office corridor with three doors that change, and the same with a box at one of three places, eight "
            "visits each, two people walking about (`configs/worlds/three_doors.yaml` and `box_at_three_places.yaml`). "
            "Patches / states that occurred, sub-map by sub-map; the adjusted Rand index of all visits.",
        ],
        ["experiment", "seed", "sub-maps", "without cause", "patches", "states", "index"],
    )
    for (world, seed), job in jobs.items():
        table.add(_EXPERIMENTS[world], lambda seed=seed, job=job: [f"{seed}", *job.result()])
    return [table]


def _experiment(bench: Bench, world: str, seed: int) -> Row:
    name = f"{world}-seed-{seed}"
    recording = bench.recorded(world, name, seed)
    run_dir, _ = bench.built(name, recording)
    truth = truth_of(recording)
    score = score_states(name, read_learned_states(run_dir, truth), truth)
    rows = score.details["sub-maps"]
    return [
        f"{score.values['submaps']:.0f}",
        f"{score.values['submaps_without_object']:.0f}",
        ", ".join(f"{row['states_found']}" for row in rows),
        ", ".join(f"{row['states_occurred']}" for row in rows),
        number(score.values["adjusted_rand_index"]),
    ]
