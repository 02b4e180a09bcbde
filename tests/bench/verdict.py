"""Lost, or is the map out of date? The verdict of localization in offices, and how soon a carried robot is found."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from dynmap_cli.arrays import B1, F64
from dynmap_cli.domain.poses import between, compose
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.localization.found import Localization
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.global_start import global_start
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.localization.watching.changes import is_another_place
from tests.bench.measured import AT_ONCE
from tests.bench.tables import Row, Table, percent
from tests.bench.verdict_scenes import KINDS, LOST, Scene, make_scene, pose_is
from tests.bench.worlds import Bench

FIRST_SEED = 1000
"""Thresholds were chosen on seeds below 100."""
N_SEEDS = 30
RAISED_S, REPAIRED_S, STARTED_S = 3.0, 5.0, 2.0
RIGHT_M, RIGHT_DEG = 0.4, 12.0
WRONG_M, WRONG_DEG = 0.7, 20.0
CHANGED_SHARE = 0.05
GAP_S, LEAST_CARRIED_M = 2.0, 5.0
OTHER_BUILDING = 500


@dataclass(frozen=True)
class Judged:
    """One run, update by update.

    Attributes
    ----------
    seconds : (n,) float64
        Since the first scan.
    right, wrong : (n,) bool
        Whether the pose is right, and whether it is clearly wrong.
    verdicts : (n,) str
    measure : (n,) float64
        How much speaks for a wrong pose, as the verdict has it.
    is_changed : (n,) bool
        Whether more than 5 % of the returns show what the map has not.
    is_elsewhere : bool
        Whether it is said that the recording is not of the place of the map.
    searches : int
    cpu_s : float
    """

    seconds: F64
    right: B1
    wrong: B1
    verdicts: np.ndarray[tuple[int, ...], np.dtype[np.str_]]
    measure: F64
    is_changed: B1
    is_elsewhere: bool
    searches: int
    cpu_s: float


@dataclass(frozen=True)
class Found:
    """Whether a robot was found, and what the start cost per 1000 m2 of map."""

    is_found: bool
    cpu_s_per_1000_m2: float


def judge_verdict(kind: str, seed: int) -> Judged:
    """Localize a scene from the pose that is given in it."""
    scene = make_scene(kind, seed)
    started = time.process_time()
    found = _localized(scene, scene.run.log, seed, tuple(scene.start.tolist()))
    return _judged(scene, found, time.process_time() - started)


def judge_other_building(seed: int) -> Judged:
    """Localize a recording in the map of another office."""
    scene, other = make_scene("fine", seed), make_scene("fine", seed + OTHER_BUILDING)
    started = time.process_time()
    found = _localized(replace(scene, grid=other.grid), scene.run.log, seed, None)
    judged = _judged(scene, found, time.process_time() - started)
    everywhere = np.ones(judged.wrong.size, dtype=bool)
    return replace(judged, right=~everywhere, wrong=everywhere)


def judge_start(seed: int) -> Found:
    """Find a robot without a guess."""
    scene = make_scene("fine", seed)
    found = _localized(scene, scene.run.log, seed, None)
    right = pose_is(found.trajectory.poses, scene.run.true_poses, 0.5, 10.0)
    later = (scene.run.log.stamps_ns - scene.run.log.stamps_ns[0]) * 1e-9 >= STARTED_S
    settings = LocalizationSettings()
    pool = make_map_pool(scene.grid, (), settings)
    with ThreadPoolExecutor(1) as executor:
        started = time.process_time()
        global_start(scene.run.log, 0, pool, settings, np.random.default_rng(seed), executor)
        cpu_s = time.process_time() - started
    frame = scene.grid.frame
    area_m2 = frame.rows * frame.cols * frame.resolution_m**2
    return Found(bool(right[later].mean() >= 0.95), cpu_s / area_m2 * 1000.0)


def judge_carried(seed: int) -> Found:
    """Carry the robot to another place in the middle of the recording."""
    scene = make_scene("fine", seed)
    log, rows = _carried(scene)
    found = _localized(scene, log, seed, tuple(scene.start.tolist()))
    right = pose_is(found.trajectory.poses, scene.run.true_poses[rows], 0.5, 10.0)
    seam = int(np.argmax(np.diff(rows))) + 1
    later = (log.stamps_ns - log.stamps_ns[seam]) * 1e-9 >= REPAIRED_S
    return Found(bool(right[later].mean() >= 0.95), 0.0)


def tables(bench: Bench) -> list[Table]:
    """Two tables."""
    seeds = range(FIRST_SEED, FIRST_SEED + (4 if bench.quick else N_SEEDS))
    with ProcessPoolExecutor(AT_ONCE) as processes:
        verdicts = {kind: [processes.submit(judge_verdict, kind, seed) for seed in seeds] for kind in KINDS}
        others = [processes.submit(judge_other_building, seed) for seed in seeds]
        starts = [processes.submit(judge_start, seed) for seed in seeds]
        carried = [processes.submit(judge_carried, seed) for seed in seeds]
        return [_verdict_table(verdicts, others, len(seeds)), _start_table(starts, carried, len(seeds))]


def area_under_curve(positive: F64, negative: F64) -> float:
    """Probability that a positive value is larger than a negative one; ties count half."""
    values, ranks, counts = np.unique(
        np.concatenate([positive, negative]), return_inverse=True, return_counts=True
    )
    middle = np.cumsum(counts) - (counts - 1) / 2.0
    rank_sum = middle[ranks.ravel()[: positive.size]].sum()
    n = positive.size
    return float((rank_sum - n * (n + 1) / 2.0) / max(n * negative.size, 1)) if values.size else float("nan")


def _localized(
    scene: Scene, log: ScanLog, seed: int, start: tuple[float, float, float] | None
) -> Localization:
    """Run the filter."""
    settings = LocalizationSettings(start=start)
    return localize_log(log, make_map_pool(scene.grid, (), settings), settings, seed=seed)


def _judged(scene: Scene, found: Localization, cpu_s: float) -> Judged:
    """Lay what was found beside the truth."""
    log, true = scene.run.log, scene.run.true_poses
    rows = np.searchsorted(log.stamps_ns, [row.stamp_ns for row in found.health])
    poses = found.trajectory.poses[rows]
    return Judged(
        seconds=(log.stamps_ns[rows] - log.stamps_ns[0]) * 1e-9,
        right=pose_is(poses, true[rows], RIGHT_M, RIGHT_DEG),
        wrong=~pose_is(poses, true[rows], WRONG_M, WRONG_DEG),
        verdicts=np.array([row.verdict for row in found.health]),
        measure=np.array([row.lost for row in found.health]),
        is_changed=scene.shifted_share[rows] > CHANGED_SHARE,
        is_elsewhere=is_another_place(found.health),
        searches=len(found.searches),
        cpu_s=cpu_s,
    )


def _carried(scene: Scene) -> tuple[ScanLog, F64]:
    """A log without the scans in its middle, while its odometry stood; and which scans it has."""
    log, true = scene.run.log, scene.run.true_poses
    leave = log.n_scans // 3
    apart = np.hypot(*(true - true[leave])[:, :2].T)
    far = np.flatnonzero((apart >= LEAST_CARRIED_M) & (np.arange(log.n_scans) > leave + 50))
    arrive = int(far[0])
    rows = np.concatenate([np.arange(leave), np.arange(arrive, log.n_scans)])
    odometry, stamps = np.array(log.odometry[rows]), np.array(log.stamps_ns[rows])
    odometry[leave:] = compose(odometry[leave - 1], between(log.odometry[arrive], log.odometry[arrive:]))
    stamps[leave:] += stamps[leave - 1] - stamps[leave] + int(GAP_S * 1e9)
    cut = replace(
        log,
        stamps_ns=stamps,
        ranges_m=log.ranges_m[rows],
        odometry=odometry,
        geometry_index=log.geometry_index[rows],
        recording_index=log.recording_index[rows],
        arrival_index=np.arange(rows.size, dtype=np.int32),
    )
    return cut, rows


def _verdict_table(
    verdicts: dict[str, list[Future[Judged]]], others: list[Future[Judged]], n_seeds: int
) -> Table:
    """Verdicts by kind of scene."""
    table = Table(
        "Lost, or is the map out of date?",
        [
            f"Offices of about 900 m2, {n_seeds} each, 45 m of way at 0.8 m/s, 181 beams over 180 degrees, "
            "localized from the true pose or, lost, from a wrong one (near: 1 to 3 m and up to 40 degrees away). "
            "Crowd: 25 people walk about, 6 go with the robot. New objects: 1 to 8 boxes. Removed walls: all doors of "
            "the map stand open, 1 to 3 pieces of wall of 1 to 3 m are gone. Thresholds were chosen on other seeds. An "
            f"update is lost where the pose is {WRONG_M:g} m or {WRONG_DEG:g} degrees off, right within {RIGHT_M:g} m "
            f"and {RIGHT_DEG:g} degrees. *Raised*: of the runs that are still lost after {RAISED_S:g} s or said so "
            "before, those that said `lost` by then. Changed in truth: more than 5 % of the returns show what the map "
            "has not, in view for 5 s. The area under the curve is that of the lost measure, of lost updates against "
            "right ones of the first four kinds; lost ones are those until the search found the robot; where "
            "the start is given, it looks after the first update. Another place: said of the recording as a whole.",
        ],
        ["scene", "right pose called lost", "raised", "called changed", "changed in truth", "precision", "recall",
         "called another place", "searches per run", "CPU s"],
    )  # fmt: skip
    for kind, jobs in verdicts.items():
        table.add(kind, lambda jobs=jobs, kind=kind: _verdict_row([job.result() for job in jobs], kind))
    well = lambda: [job.result() for kind, jobs in verdicts.items() if kind not in LOST for job in jobs]  # noqa: E731
    lost = lambda: [job.result() for kind in LOST for job in verdicts[kind]]  # noqa: E731
    table.add("all", lambda: _total_row(well(), lost()))
    table.add("another building", lambda: _verdict_row([job.result() for job in others], "another building"))
    table.remark("verdict lost or changed", lambda: _short(well(), lost()))
    return table


def _verdict_row(runs: Sequence[Judged], kind: str) -> Row:
    said = np.concatenate([run.verdicts == "changed" for run in runs])
    true = np.concatenate([run.is_changed for run in runs])
    is_lost = kind in LOST or kind == "another building"
    called = percent(float(said.mean()))
    precision, recall = ("-", "-") if is_lost else _precision_recall(said, true)
    return [
        "-" if kind == "another building" else percent(_false_share(runs), 2),
        percent(_raised_share(runs)) if is_lost else "-",
        called,
        "-" if is_lost else percent(float(true.mean())),
        precision,
        recall,
        percent(float(np.mean([run.is_elsewhere for run in runs]))),
        f"{sum(run.searches for run in runs) / len(runs):.1f}",
        f"{sum(run.cpu_s for run in runs) / len(runs):.1f}",
    ]


def _total_row(well: Sequence[Judged], lost: Sequence[Judged]) -> Row:
    said = np.concatenate([run.verdicts == "changed" for run in well])
    true = np.concatenate([run.is_changed for run in well])
    return [
        percent(_false_share([*well, *lost]), 2),
        percent(_raised_share(lost)),
        percent(float(said.mean())),
        percent(float(true.mean())),
        *_precision_recall(said, true),
        percent(float(np.mean([run.is_elsewhere for run in [*well, *lost]]))),
        "",
        f"area under the curve {_area(well, lost):.4f}",
    ]


def _short(well: Sequence[Judged], lost: Sequence[Judged]) -> str:
    said = np.concatenate([run.verdicts == "changed" for run in well])
    true = np.concatenate([run.is_changed for run in well])
    precision, recall = _precision_recall(said, true)
    return (
        f"area under the curve {_area(well, lost):.3f}; lost within {RAISED_S:g} s {percent(_raised_share(lost))}, "
        f"right pose called lost {percent(_false_share([*well, *lost]), 2)}; changed: precision {precision}, "
        f"recall {recall}"
    )


def _area(well: Sequence[Judged], lost: Sequence[Judged]) -> float:
    """Of the lost measure: updates that are lost against right ones where nobody was lost."""
    return area_under_curve(
        np.concatenate([run.measure[run.wrong] for run in lost]),
        np.concatenate([run.measure[run.right] for run in well]),
    )


def _false_share(runs: Sequence[Judged]) -> float:
    """Share of the updates with a right pose that are called lost."""
    return float(np.concatenate([run.verdicts[run.right] == "lost" for run in runs]).mean())


def _raised_share(runs: Sequence[Judged]) -> float:
    """Share of the lost runs that said so in time; who was right again before it was said does not count."""
    found = []
    for run in runs:
        early = run.seconds <= RAISED_S
        said = bool((run.verdicts[early & ~run.right] == "lost").any())
        if said or bool(run.wrong[early][-1]):
            found.append(said)
    return float(np.mean(found)) if found else float("nan")


def _precision_recall(said: B1, true: B1) -> tuple[str, str]:
    both = float((said & true).sum())
    return (
        percent(both / float(said.sum())) if said.any() else "-",
        percent(both / float(true.sum())) if true.any() else "-",
    )


def _start_table(starts: list[Future[Found]], carried: list[Future[Found]], n_seeds: int) -> Table:
    """Global starts and carried robots."""
    table = Table(
        "Global start and kidnapping",
        [
            f"The offices above, {n_seeds} each, default settings. Start: nothing is known, found when 95 % of the "
            f"poses from {STARTED_S:g} s on are within 0.5 m and 10 degrees. Carried: after a third of the recording "
            f"the robot is {LEAST_CARRIED_M:g} m away or more, odometry goes on as if it had stood for {GAP_S:g} s; "
            f"repaired when 95 % of the poses from {REPAIRED_S:g} s on are.",
        ],
        ["what", "found", "CPU s per 1000 m2, median", "largest"],
    )  # fmt: skip

    def row(jobs: list[Future[Found]], cost: Callable[[list[float]], Row]) -> Row:
        results = [job.result() for job in jobs]
        share = percent(float(np.mean([one.is_found for one in results])))
        return [share, *cost([one.cpu_s_per_1000_m2 for one in results])]

    table.add("global start", lambda: row(starts, lambda s: [f"{np.median(s):.2f}", f"{max(s):.2f}"]))
    table.add("carried elsewhere", lambda: row(carried, lambda _: ["", ""]))
    table.remark("global start in offices", lambda: "found " + row(starts, lambda _: [])[0])
    table.remark(
        "robot carried elsewhere", lambda: f"found within {REPAIRED_S:g} s " + row(carried, lambda _: [])[0]
    )
    return table
