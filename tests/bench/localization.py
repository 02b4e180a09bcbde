"""Localization in worlds that change, beside plain localization in the filtered map and in maps of one state."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from dynmap_cli.evaluation.localization import read_localized, score_localization
from dynmap_cli.evaluation.object_beliefs import read_object_shares
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.evaluation.states import read_learned_states
from dynmap_cli.simulation import load_scenario, simulate
from tests.bench import states
from tests.bench.measured import SAMPLES, dynmap
from tests.bench.tables import Row, Table, banded, bands_of
from tests.bench.worlds import LANE, Bench, truth_of
from tests.golden.corridor import STATES, Corridor, paint_plain_map

LANES: dict[str, LANE] = {
    "two_doors": {"repeat": 3},
    "four_places": {"repeat": 5},
    "only_doors": {"repeat": 1},
    "office_days": {"repeat": 1, "days": 2},
}
OTHER_DAY = 100
"""Added to the seed of the mapped recording: other states at other times, other noise."""
METHODS = (
    "patch map",
    "patch map, state in each particle",
    "plain, filtered map",
    "plain, average of all states",
)
STATES_OF = {METHODS[1]: "sampled"}
"""`localization.states` of the methods that do not take the default."""
_COLUMNS = {
    "success": "success",
    "time_to_converge_s": "converged, s",
    "position_error_mean_m": "error, m",
    "position_error_p95_m": "error 95 %, m",
    "heading_error_mean_deg": "error, deg",
    "combination_accuracy": "state right",
    "state_accuracy": "patch right",
    "state_mapped_share": "state ever mapped",
    "state_accuracy_when_mapped": "right of those mapped",
    "state_sure_share": "patch sure",
    "object_accuracy": "object right",
    "object_sure_share": "object sure",
    "state_changes_noticed_share": "changes noticed",
    "state_delay_median_s": "delay, s",
    "false_alarm_share": 'false "lost"',
}


@dataclass(frozen=True)
class Localized:
    """One result.

    Attributes
    ----------
    score : Score
    cpu_ms : float
        CPU of the whole process, start and reading included, per scan.
    """

    score: Score
    cpu_ms: float


def judge(
    bench: Bench, run_dir: Path, mapped: Path, recording: Path, method: str, map_yaml: Path | None
) -> Localized:
    """Localize a recording and compare it with its truth; without *map_yaml* in the run's patch map."""
    name = f"{run_dir.name}-{method.replace(', ', '-').replace(' ', '-')}"
    words: tuple[object, ...] = (run_dir, recording) if map_yaml is None else ("--map", map_yaml, recording)
    if method in STATES_OF:
        words += ("--set", f"localization.states={STATES_OF[method]}")
    out_dir, cost = bench.localized(name, *words)
    truth, map_truth = truth_of(recording), truth_of(mapped)
    learned = bench.jobs.once(("learned", run_dir.name), lambda: read_learned_states(run_dir, map_truth))
    shares = bench.jobs.once(("objects", run_dir.name), lambda: read_object_shares(run_dir, map_truth))
    with_states = (map_truth, shares) if map_yaml is None else (None, None)
    score = score_localization(name, read_localized(out_dir), truth, learned, *with_states)
    return Localized(score, 1000.0 * cost.cpu_s / truth.trajectory.stamps_ns.size)


def plain_map(bench: Bench, run_dir: Path, method: str) -> Path | None:
    """The map of a plain method: that of the run, or one with all states of each sub-map; None for patch maps."""
    if method == METHODS[2]:
        return run_dir / "map" / "map.yaml"
    if method != METHODS[3]:
        return None

    def make() -> Path:
        out_dir = bench.folder / "average_maps" / run_dir.name
        dynmap(
            "export", run_dir, "--state", "union", "-o", out_dir, "--force", log=out_dir.with_suffix(".txt")
        )
        return out_dir / "map.yaml"

    return bench.jobs.once(("average", run_dir.name), make)


def judge_world(bench: Bench, world: str, seed: int, method: str) -> Localized:
    """Map one recording of a world, localize another one."""
    name = states.name_of(world, seed)
    mapped = bench.recorded(world, name, seed, states.WORLDS[world])
    run_dir, _ = bench.built(name, mapped)
    recording = bench.recorded(world, f"{name}-other-day", seed + OTHER_DAY, LANES[world])
    return judge(bench, run_dir, mapped, recording, method, plain_map(bench, run_dir, method))


def sample(bench: Bench, day: str) -> Path:
    """Make a sample recording again, with its truth."""

    def make() -> Path:
        path = bench.folder / "logs" / f"corridor_{day}.mcap"
        path.parent.mkdir(parents=True, exist_ok=True)
        scenario = SAMPLES / f"corridor_{day}.yaml"
        dynmap("simulate", scenario, "-o", path, "--force", log=path.with_suffix(".txt"))
        return path

    return bench.jobs.once(("simulate", day), make)


def judge_samples(bench: Bench, method: str) -> Localized:
    """Localize the sample recording of Tuesday in maps made of Monday's."""
    monday, tuesday = sample(bench, "monday"), sample(bench, "tuesday")
    run_dir, _ = bench.built("corridor", monday)
    plain = plain_map(bench, run_dir, method)
    if method.startswith("plain, doors"):
        scenarios = (load_scenario(SAMPLES / f"corridor_{day}.yaml") for day in ("monday", "tuesday"))
        corridor = Corridor(run_dir, run_dir, *map(simulate, scenarios))
        plain = paint_plain_map(corridor, method.rpartition(" ")[2], bench.folder / "plain_maps")
    return judge(bench, run_dir, monday, tuesday, method, plain)


def tables(bench: Bench) -> list[Table]:
    """One table."""
    table = Table(
        "Localization",
        [
            "A world is mapped as for the states above; another recording of it, with other states and "
            "other noise, is "
            "localized from a global start with default settings. Success: within 0.5 m and 10 degrees "
            "for 95 % of the "
            "run after convergence; errors are those after convergence; a state is sure from 0.8 on. "
            "The state of a sub-map in view is right if the likeliest patch is what was there, or else if all "
            "objects in view are as they were and everything there is one of the objects. "
            "A patch is the state of all objects of its sub-map together, also of those out of view, and where they "
            "were never seen like this while the map was made no patch is right: how often one could be, and was, are "
            "columns of their own; so are objects one by one, where beams tell on from off; the delay of a "
            f"change in view is a median. Mean over {len(bench.seeds)} seeds, with the 5 and 95 % band "
            f"of its bootstrap. "
            "The recording of seed 1 in `only_doors` shows its three doors shut all along: the corridor then looks the "
            "same from both ends, `localize` says so, and which end it follows is chance. "
            "*Plain* is Monte Carlo localization without patches, in the filtered map of the same run "
            "(`--map RUN/map/map.yaml`) and in that with all states of each sub-map at once "
            "(`dynmap export --state union`), in the sample logs also in maps with both doors in one state.",
        ],
        ["world", "map", *_COLUMNS.values(), "CPU ms per scan"],
    )
    worlds = ["two_doors"] if bench.quick else list(LANES)
    results: dict[tuple[str, str], list[Future[Localized]]] = {
        (world, method): [bench.jobs.start(judge_world, bench, world, seed, method) for seed in bench.seeds]
        for world in worlds
        for method in METHODS
    }
    for method in (*METHODS, *(f"plain, doors {state}" for state in STATES)):
        results["sample logs", method] = [bench.jobs.start(judge_samples, bench, method)]
    for (world, method), jobs in results.items():
        table.add(world, lambda method=method, jobs=jobs: [method, *_cells([job.result() for job in jobs])])
    for world in (*worlds, "sample logs"):
        table.remark(f"localization, {world}", lambda world=world: _short(results, world))
    return [table]


def _cells(results: list[Localized]) -> Row:
    """Bands of each measure."""
    found = bands_of([one.score for one in results])
    cells = []
    for name in _COLUMNS:
        cells.append(banded(found[name], 1 if name.endswith("_s") else 3) if name in found else "-")
    return [*cells, f"{sum(one.cpu_ms for one in results) / len(results):.2f}"]


def _short(results: dict[tuple[str, str], list[Future[Localized]]], world: str) -> str:
    words = []
    for (of_world, method), jobs in results.items():
        if of_world == world and method != METHODS[1]:
            found = bands_of([job.result().score for job in jobs])
            words.append(
                f"{method}: {banded(found['position_error_mean_m'])} m, success {found['success'].mean:.2f}"
            )
            for measure, name in (("combination_accuracy", "state"), ("object_accuracy", "object")):
                if measure in found:
                    words[-1] += f", {name} right {found[measure].mean:.3f}"
    return "; ".join(words)
