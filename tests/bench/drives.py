"""The same visits as one recording and as several with other starts: what is learned should be the same."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynmap_cli.domain.poses import between
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.evaluation.states import read_learned_states, score_states
from dynmap_cli.simulation import SimulatedRun, load_scenario, simulate
from dynmap_cli.simulation.recording import write_recording
from tests.bench.measured import dynmap
from tests.bench.states import WORLDS, judge, name_of
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_of

_WORLD = "office_days"
_PAUSE_S, _LATER_S = 60.0, 6.0
_BOUND = 0.02
_MAP_FILES = ("map/map.pgm", "map/trajectory.tum", "map/trajectory.g2o", "map/reflectance.npz")


@dataclass(frozen=True)
class Outcome:
    """What was learned from one recording, from several, and from several with the last one added afterwards."""

    whole: Score
    parts: Score
    n_parts: int
    cpu_s: float
    is_update_equal: bool


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Several drives in one map",
        [
            f"The visits of `{_WORLD}` as one recording, and cut at the pauses into recordings of their own, each of "
            f"which starts {_LATER_S:g} s later in its visit than the one before and with its odometry at the origin. "
            "They are built in one call, and once more with the last one added by `dynmap update`. *Index*: adjusted "
            "Rand index of the visits as in the table of states; bound: a difference of "
            f"{_BOUND:g}, what misses it is **bold**. *Update*: whether map, path and graph are the same bytes.",
        ],
        ["seed", "recordings", "index, one", "index, several", "difference", "sub-maps", "update", "CPU s"],
    )
    jobs = {seed: bench.jobs.start(_outcome, bench, seed) for seed in bench.seeds}
    for seed, job in jobs.items():
        table.add(str(seed), lambda job=job: _row(job.result()))
    table.remark("several drives in one map", lambda: _short(list(jobs.values())))
    return [table]


def _outcome(bench: Bench, seed: int) -> Outcome:
    """Build the parts, and compare."""
    whole, _ = judge(bench, _WORLD, seed)
    recording = bench.recorded(_WORLD, name_of(_WORLD, seed), seed, WORLDS[_WORLD])
    folder = bench.folder / "drives" / str(seed)
    parts = _write_parts(recording.with_suffix(".yaml"), folder)
    run_dir, updated = folder / "run", folder / "updated"
    cost = dynmap("build", *parts, "-o", run_dir, "--force", log=folder / "build.txt")
    dynmap("build", *parts[:-1], "-o", updated, "--force", log=folder / "before.txt")
    dynmap("update", updated, parts[-1], log=folder / "update.txt")
    truth = truth_of(recording)
    score = score_states("parts", read_learned_states(run_dir, truth), truth)
    is_equal = all((run_dir / name).read_bytes() == (updated / name).read_bytes() for name in _MAP_FILES)
    return Outcome(whole, score, len(parts), cost.cpu_s, is_equal)


def _write_parts(scenario: Path, folder: Path) -> list[Path]:
    """Recordings of the visits of a scenario."""
    folder.mkdir(parents=True, exist_ok=True)
    run = simulate(load_scenario(scenario))
    stamps = run.log.stamps_ns
    visits = np.split(np.arange(stamps.size), np.flatnonzero(np.diff(stamps) > _PAUSE_S * 1e9) + 1)
    paths = []
    for k, rows in enumerate(visits):
        begun = rows[stamps[rows] >= stamps[rows[0]] + int(k * _LATER_S * 1e9)]
        paths.append(folder / f"visit_{k}.mcap")
        write_recording(paths[-1], _part(run, slice(int(begun[0]), int(begun[-1]) + 1)))
    return paths


def _part(run: SimulatedRun, scans: slice) -> SimulatedRun:
    """Some scans of a run with their odometry, which starts at the origin."""
    log, series = run.log.select(scans), run.odometry
    inside = (series.stamps_ns >= log.stamps_ns[0]) & (series.stamps_ns <= log.stamps_ns[-1] + 10**8)
    start = series.poses[inside][0]
    return replace(
        run,
        log=replace(log, odometry=between(start, log.odometry)),
        odometry=replace(
            series, stamps_ns=series.stamps_ns[inside], poses=between(start, series.poses[inside])
        ),
        true_poses=run.true_poses[scans],
        beam_class=run.beam_class[scans],
        object_states=run.object_states[scans],
    )


def _indices(outcome: Outcome) -> tuple[float, float]:
    return outcome.whole.values["adjusted_rand_index"], outcome.parts.values["adjusted_rand_index"]


def _row(outcome: Outcome) -> Row:
    one, several = _indices(outcome)
    difference = number(several - one, 3)
    return [
        str(outcome.n_parts),
        number(one, 3),
        number(several, 3),
        difference if several - one >= -_BOUND else f"**{difference}**",
        f"{outcome.whole.values['submaps']:g}, {outcome.parts.values['submaps']:g}",
        "equal" if outcome.is_update_equal else "**differs**",
        f"{outcome.cpu_s:.1f}",
    ]


def _short(jobs: list[Future[Outcome]]) -> str:
    outcomes = [job.result() for job in jobs]
    ones, several = np.mean([_indices(outcome) for outcome in outcomes], axis=0)
    equal = sum(outcome.is_update_equal for outcome in outcomes)
    return (
        f"adjusted Rand index {several:.3f}, {ones:.3f} as one recording; update equals build in {equal} of "
        f"{len(outcomes)}"
    )
