"""Speed of the inner loops and of start, simulation and reading, each beside a yardstick measured in the same run."""

from __future__ import annotations

import bz2
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I32, I64
from dynmap_cli.counting.counts import Counter, count_beams
from dynmap_cli.counting.em import FilterParams, em_step, fixed_point
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame, OccupancyGrid
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.evaluation.truth import read_run
from dynmap_cli.files.patch_archive import read_patches
from dynmap_cli.files.pgm import read_map
from dynmap_cli.files.scan_log import read_scan_log
from dynmap_cli.files.trajectory import read_tum
from dynmap_cli.kernels.em import look_up
from dynmap_cli.kernels.jit import kernel
from dynmap_cli.localization.sensing.beam_model import scan_beam_log_likelihoods, with_beam_model
from dynmap_cli.localization.sensing.map_pool import make_map_pool
from dynmap_cli.localization.sensing.sensor import Sweep, scan_log_likelihoods
from dynmap_cli.localization.settings import LocalizationSettings
from dynmap_cli.localization.starting.global_start import lattice_candidates, search_again
from dynmap_cli.localization.tracking import localize_log
from dynmap_cli.simulation import load_scenario, simulate
from tests.bench import beams, real_logs
from tests.bench.localization import sample
from tests.bench.measured import run, stage_seconds, summary_of
from tests.bench.rays import cells_on_ray
from tests.bench.reading import reading_rows
from tests.bench.tables import Row, Table
from tests.bench.worlds import Bench, truth_folder

REPEATS, CELLS_PER_BEAM, RESOLUTION_M = 5, 70, 0.05


@kernel
def traverse(
    x0: F64, y0: F64, x1: F64, y1: F64, rows: int, cols: int, cells: I64, lengths: F64, out: I32
) -> int:
    """Write the flat index of every cell of every ray, in order; how many there are."""
    total = 0
    for ray in range(x0.size):
        count = cells_on_ray(x0[ray], y0[ray], x1[ray], y1[ray], rows, cols, cells, lengths)
        for k in range(count):
            out[total] = cells[k, 0] * cols + cells[k, 1]
            total += 1
    return total


@kernel
def count_plainly(x0: F64, y0: F64, x1: F64, y1: F64, cells: I64, lengths: F64, grid: F64) -> None:
    """Count by the plain traversal."""
    for ray in range(x0.size):
        count = cells_on_ray(x0[ray], y0[ray], x1[ray], y1[ray], *grid.shape, cells, lengths)
        for k in range(count):
            grid[cells[k, 0], cells[k, 1]] += lengths[k]


@kernel
def replay(stream: I32, grid: I64) -> None:
    """One load, one add, one store for every cell of the stream."""
    for k in range(stream.size):
        grid[stream[k]] += 1


def cpu_s(work: Callable[[], object]) -> float:
    """Least CPU seconds of several calls, after one that compiles."""
    work()
    found = []
    for _ in range(REPEATS):
        started = time.process_time()
        work()
        found.append(time.process_time() - started)
    return min(found)


def wall_s(work: Callable[[], object]) -> float:
    """Least wall time of several calls."""
    found = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        work()
        found.append(time.perf_counter() - started)
    return min(found)


def scans_of(n_scans: int, n_beams: int) -> tuple[ScanLog, F64, GridFrame]:
    """Scans along a circle in a hall of 60 x 60 m, 4 cm apart, with beams that pass 70 cells on average."""
    draw = np.random.default_rng(0)
    mean_m = CELLS_PER_BEAM * RESOLUTION_M * np.pi / 4.0
    ranges = draw.uniform(0.5 * mean_m, 1.5 * mean_m, (n_scans, n_beams)).astype(np.float32)
    log = ScanLog(
        stamps_ns=np.arange(n_scans, dtype=np.int64) * 200_000_000,
        ranges_m=ranges,
        odometry=np.zeros((n_scans, 3)),
        geometry_index=np.zeros(n_scans, dtype=np.int32),
        bearings_rad=np.linspace(-np.pi / 2, np.pi / 2, n_beams)[None],
        sensor_poses=np.zeros((1, 3)),
        range_limits_m=np.array([[0.0, 30.0]]),
        beam_interval_s=np.zeros(1),
        recording_index=np.zeros(n_scans, dtype=np.int32),
        recordings=("bench",),
    )
    way = np.arange(n_scans) * 0.04 / 15.0
    poses = np.column_stack([30.0 + 15.0 * np.cos(way), 30.0 + 15.0 * np.sin(way), way + np.pi / 2])
    return log, poses, GridFrame(RESOLUTION_M, 0.0, 0.0, 1200, 1200)


def counting_rows(table: Table) -> None:
    """Counting beside the plain traversal and beside the same stream of memory accesses."""
    log, poses, frame = scans_of(1000, 180)
    yaw = poses[:, 2:3] + log.bearings_rad
    x0, y0 = (np.repeat(poses[:, k] / RESOLUTION_M, log.n_beams) for k in (0, 1))
    length = log.ranges_m.astype(np.float64) / RESOLUTION_M
    x1, y1 = x0 + (length * np.cos(yaw)).ravel(), y0 + (length * np.sin(yaw)).ravel()
    cells, lengths = np.empty((1000, 2), dtype=np.int64), np.empty(1000)
    stream = np.empty(log.n_scans * log.n_beams * 200, dtype=np.int32)
    n_cells = traverse(x0, y0, x1, y1, frame.rows, frame.cols, cells, lengths, stream)
    stream = stream[:n_cells].copy()
    counter, plain = Counter(frame), np.zeros(frame.shape)
    memory = np.zeros(frame.rows * frame.cols, dtype=np.int64)
    ours = cpu_s(lambda: counter.add(log, poses, 30.0)) / n_cells * 1e9
    sums = cpu_s(counter.counting_map)
    floor = cpu_s(lambda: replay(stream, memory)) / n_cells * 1e9
    plainly = cpu_s(lambda: count_plainly(x0, y0, x1, y1, cells, lengths, plain)) / n_cells * 1e9
    per_beam = n_cells / log.n_scans / log.n_beams
    table.rows += [
        [
            "counting, ns per visited cell",
            f"{ours:.2f}",
            "0.9",
            f"{per_beam:.0f} cells per beam, hits and centroids too",
        ],
        [
            "same stream, one load, add and store each",
            f"{floor:.2f}",
            "",
            f"counting takes {ours / floor:.2f} times as long",
        ],
        [
            "plain traversal, ns per visited cell",
            f"{plainly:.2f}",
            "",
            f"{plainly / ours:.2f} times counting",
        ],
        [
            "sums of the difference grids, ms",
            f"{1000 * sums:.0f}",
            "",
            f"once per map, {frame.rows} x {frame.cols} cells",
        ],
    ]
    table.short.append(
        ("counting", f"{ours:.2f} ns per visited cell, {ours / floor:.1f} times the same memory stream")
    )


def em_row() -> Row:
    """One round at fixed poses: fixed point of all cells, e of all beams."""
    draw = np.random.default_rng(0)
    n_cells, params = 400_000, FilterParams()
    hits, passed = draw.uniform(0, 50, n_cells), draw.uniform(0, 50, n_cells)
    cells = draw.integers(-1, n_cells, (5556, 180)).astype(np.int32)
    out = np.empty(cells.shape, dtype=np.float32)

    def one_round() -> None:
        reflectance = fixed_point(hits, passed, params)
        expected = em_step(reflectance, np.ones(n_cells), params.static_prior)
        look_up(cells, expected.astype(np.float32), out)

    return [f"{1000 * cpu_s(one_round):.1f}", "15", f"{cells.size / 1e6:.1f} million beams, {n_cells} cells"]


def intel_rows(bench: Bench, table: Table) -> None:
    """Reading, counting and building of a long real log."""
    names = ("one count of all Intel beams, s", "two threads, times as fast")
    try:
        run_dir, cost = real_logs.build_log(bench, real_logs.LOGS[0], "as recorded")
    except real_logs.AbsentError:
        table.rows += [[name, "skipped: no recording", "", ""] for name in names]
        return
    one = read_run(run_dir)
    frame = frame_of_scans(one.log, one.poses, 30.0, RESOLUTION_M)
    seconds = cpu_s(lambda: count_beams(one.log, one.poses, frame, 30.0))
    walls = [wall_s(lambda n=n: count_beams(one.log, one.poses, frame, 30.0, threads=n)) for n in (1, 2)]
    stages = stage_seconds(run_dir)
    recording = bench.data / "benchmark" / real_logs.LOGS[0].file
    bare = cpu_s(lambda: _parse_bare(recording))
    table.rows += [
        [names[0], f"{seconds:.2f}", "0.25", "sums of the grids and centroids included"],
        [names[1], f"{walls[0] / walls[1]:.2f}", "1.7", "wall time; needs a quiet machine"],
        ["Intel, reading, s", f"{stages['ingest']:.2f}", "1", f"unpacking and splitting alone {bare:.2f}"],
        ["Intel, path, loops, graph, two rounds of EM, s", f"{stages['map']:.1f}", "4", ""],
        ["Intel, whole build, s", f"{cost.cpu_s:.1f}", "8", f"peak {cost.peak_mb:.0f} MB; 400 allowed"],
    ]


def _parse_bare(recording: Path) -> int:
    """Unpack a text log and turn the numbers of its scans into arrays, nothing else."""
    count = 0
    for line in bz2.decompress(recording.read_bytes()).splitlines():
        if line.startswith(b"FLASER"):
            count += np.array(line.split()[2:-2], dtype=np.float64).size
    return count


def likelihood_rows(table: Table) -> None:
    """Weighing particles."""
    draw = np.random.default_rng(0)
    frame = GridFrame(RESOLUTION_M, 0.0, 0.0, 600, 600)
    pool = draw.normal(-2.0, 1.0, frame.rows * frame.cols + 100 * 100).astype(np.float32)
    poses = np.column_stack([draw.normal(15, 0.2, (1000, 2)), draw.normal(0, 0.1, 1000)])
    angles = np.linspace(-np.pi / 2, np.pi / 2, 180)
    ends = np.column_stack([np.cos(angles), np.sin(angles)]) * draw.uniform(2, 10, (180, 1))
    windows = np.tile(np.array([250, 250, 100, 100, frame.rows * frame.cols], dtype=np.int32), (1000, 1))
    for words, chosen, budget in (("", None, "1000"), (", with patches", windows, "700")):
        seconds = cpu_s(lambda chosen=chosen: scan_log_likelihoods(pool, frame, poses, ends, chosen))
        speed = poses.shape[0] * ends.shape[0] / seconds / 1e6
        table.rows.append([
            f"likelihood field{words}, million particle-beams per s", f"{speed:.0f}", budget,
            f"1000 particles x 180 beams, tracking: {1000 * seconds:.2f} ms",
        ])  # fmt: skip
        table.short.append((f"likelihood field{words}", f"{speed:.0f} million particle-beams per second"))


def beam_rows(table: Table) -> None:
    """Weighing particles by Eq. 1.1, at the same places and with the same beams as the likelihood field."""
    draw = np.random.default_rng(0)
    frame = GridFrame(RESOLUTION_M, 0.0, 0.0, 600, 600)
    cells = np.where(draw.random(frame.shape) < 0.02, OCCUPIED, FREE).astype(np.int8)
    angles = np.linspace(-np.pi / 2, np.pi / 2, 180)
    mean_m = CELLS_PER_BEAM * RESOLUTION_M * np.pi / 4.0
    sweep = Sweep(np.zeros(2), angles, draw.uniform(0.5 * mean_m, 1.5 * mean_m, 180), 30.0)
    poses = np.column_stack([draw.normal(15, 0.2, (1000, 2)), draw.normal(0, 0.1, 1000)])
    settings = LocalizationSettings(max_beams=180)
    grid = OccupancyGrid(frame, cells)
    pool = with_beam_model(make_map_pool(grid, (), settings), grid, None, ())
    log_pass = np.concatenate([pool.log_pass, np.full(100 * 100, -0.01, dtype=np.float32)])
    window = np.array([250, 250, 100, 100, pool.log_pass.size], dtype=np.int32)
    pool, windows = replace(pool, log_pass=log_pass), np.tile(window, (1000, 1))
    for words, chosen in (("", None), (", with patches", windows)):
        seconds = cpu_s(lambda chosen=chosen: scan_beam_log_likelihoods(pool, poses, sweep, settings, chosen))
        speed = poses.shape[0] * angles.size / seconds / 1e6
        table.rows.append([
            f"beam model{words}, million particle-beams per s", f"{speed:.1f}", "5",
            f"1000 particles x 180 beams of {CELLS_PER_BEAM} cells: {1000 * seconds:.0f} ms",
        ])  # fmt: skip
        table.short.append((f"beam model{words}", f"{speed:.1f} million particle-beams per second"))


def whole_update_row(bench: Bench) -> Row:
    """One update of the filter with patches in view, everything included but start and reading."""
    run_dir, _ = bench.built("corridor", sample(bench, "monday"))
    out_dir, _ = bench.localized("corridor-alone", run_dir, sample(bench, "tuesday"))
    log = read_scan_log(out_dir / "scans")
    log = replace(
        log, ranges_m=np.ascontiguousarray(log.ranges_m[:, :180]), bearings_rad=log.bearings_rad[:, :180]
    )
    start = read_tum(out_dir / "trajectory.tum").poses[0]
    settings = LocalizationSettings(
        min_particles=1000, max_particles=1000, max_beams=180, start=tuple(start.tolist())
    )
    grid, _ = read_map(run_dir / "map" / "map.yaml")
    pool = make_map_pool(grid, read_patches(run_dir / "patches" / "patches.zip"), settings)
    updates = len(localize_log(log, pool, settings, seed=0).health)
    seconds = cpu_s(lambda: localize_log(log, pool, settings, seed=0))
    with ThreadPoolExecutor(1) as executor:
        random = np.random.default_rng(0)
        check_s = cpu_s(lambda: search_again(log, 0, start, pool, settings, random, executor, is_given=True))
    seconds -= check_s
    return [
        f"{1000 * seconds / updates:.2f}",
        "0.5",
        f"motion, weighing, states of {len(pool.submaps)} sub-maps, health, estimate, resampling; without "
        f"{check_s:.2f} s for the check of the given start in the whole map",
    ]


def start_row(bench: Bench) -> Row:
    """Lattice of a global start in an office."""
    recording = bench.recorded("still_office", "still_office-cut", lane=beams.CUT["still_office"])
    run_dir, _ = bench.built("still_office-cut", recording)
    grid, _ = read_map(truth_folder(recording) / "map.yaml")
    settings = LocalizationSettings()
    pool, log = make_map_pool(grid, (), settings), read_scan_log(run_dir / "scans")
    with ThreadPoolExecutor(1) as executor:
        seconds = cpu_s(lambda: lattice_candidates(log, 0, pool, settings, executor))
    area = grid.frame.rows * grid.frame.cols * grid.frame.resolution_m**2
    return [f"{seconds / area * 1000:.2f}", "0.5", f"{seconds:.2f} s for {area:.0f} m2, 60 beams"]


def update_row(bench: Bench) -> Row:
    """Localization, everything included, per weighed scan."""
    run_dir, _ = bench.built("corridor", sample(bench, "monday"))
    out_dir, _ = bench.localized("corridor-alone", run_dir, sample(bench, "tuesday"))
    updates = int(summary_of(out_dir, "localize")["updates"])
    seconds = stage_seconds(out_dir)["localize"]
    return [
        f"{1000 * seconds / updates:.2f}",
        "",
        f"{updates} updates of Tuesday's sample, start and health included",
    ]


def simulation_row(bench: Bench) -> Row:
    """Scans of 360 beams per second in a large office."""
    bench.recorded("office_two_hours", "office_two_hours-cut", lane=beams.CUT["office_two_hours"])
    scenario = load_scenario(bench.folder / "logs" / "office_two_hours-cut.yaml")
    made = simulate(scenario)
    started = time.process_time()
    simulate(scenario)
    speed = made.log.n_scans / (time.process_time() - started)
    return [f"{speed:.0f}", "2000", f"{made.log.n_scans} scans of 360 beams in a large office with people"]


def help_row(bench: Bench) -> Row:
    """Start of the command line."""
    words = [Path(sys.executable).with_name("dynmap"), "--help"]
    found = [run(words, log=bench.folder / "help.txt").cpu_s for _ in range(REPEATS)]
    return [f"{min(found):.2f}", "0.15", ""]


def compile_row(bench: Bench) -> Row:
    """Compilation of all kernels into an empty cache."""
    words = [Path(sys.executable).with_name("dynmap"), "warmup", "-q"]
    cache = ["env", f"NUMBA_CACHE_DIR={bench.folder / 'numba_cache'}"]
    first = run([*cache, *words], log=bench.folder / "compile.txt").cpu_s
    second = run([*cache, *words], log=bench.folder / "compile.txt").cpu_s
    return [f"{first:.0f}", "20", f"`dynmap warmup` on an empty cache; {second:.1f} once compiled"]


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Speed of the parts",
        [
            f"CPU time on one core, least of {REPEATS} calls, nothing else of the bench running. The "
            f"budget is what was "
            "aimed at on a quiet machine with two cores.",
        ],
        ["what", "measured", "budget", "beside"],
    )
    for part in (counting_rows, likelihood_rows, beam_rows):
        _try(table, part.__name__, lambda part=part: part(table))
    _try(table, "Intel", lambda: intel_rows(bench, table))
    table.add("one round of EM at fixed poses, ms", em_row)
    table.add("lattice of a global start, s per 1000 m2", lambda: start_row(bench))
    table.add(
        "one update, everything included, 1000 particles x 180 beams, with patches, ms",
        lambda: whole_update_row(bench),
    )
    table.add("localization, ms per update", lambda: update_row(bench))
    table.add("simulation, scans per s", lambda: simulation_row(bench))
    _try(table, "reading", lambda: reading_rows(bench, table, cpu_s))
    table.add("`dynmap --help`, s", lambda: help_row(bench))
    table.add("compilation, s", lambda: compile_row(bench))
    if (load := os.getloadavg()[0]) > 1.5:
        table.about.append(f"The machine was not quiet: load {load:.1f} at the end.")
    return [table]


def _try(table: Table, name: str, add_rows: Callable[[], None]) -> None:
    """Add several rows; if they cannot be made, one row says why."""
    try:
        add_rows()
    except Exception as err:
        table.rows.append([name, f"**failed**: {type(err).__name__}: {err}", "", ""])
