"""States of places against what doors and boxes really did, over several seeds."""

from __future__ import annotations

from concurrent.futures import Future

from dynmap_cli.evaluation.objects import score_run
from dynmap_cli.evaluation.scores import Score
from tests.bench.tables import Row, Table, banded, bands_of
from tests.bench.worlds import LANE, Bench, truth_of

WORLDS: dict[str, LANE] = {
    "two_doors": {},
    "four_places": {},
    "only_doors": {"repeat": 6},
    "office_days": {"repeat": 3, "days": 2},
}
"""Worlds that change, with fewer visits than the scenario asks for where it is a large one."""
_COLUMNS = {
    "adjusted_rand_index": "adjusted Rand index",
    "right_number_of_states_share": "right number of states",
    "objects_found_share": "objects found",
    "submaps": "sub-maps",
    "submaps_without_object": "false sub-maps",
    "visits": "visits",
    "visits_assigned_share": "visits assigned",
    "object_states_right_share": "objects right",
    "object_states_unknown_share": "objects unknown",
    "object_states_in_view_unknown_share": "in view",
}


SMALL_AREAS, SMALL_AREAS_SEEDS = ("--set", "segmentation.max_area_m2=6"), (1, 2, 3, 4, 5, 6)


def name_of(world: str, seed: int) -> str:
    """Name of recording and run of a seed."""
    return f"{world}-seed-{seed}"


def judge(bench: Bench, world: str, seed: int, *options: str) -> tuple[Score, float]:
    """Simulate, build, compare with the truth; the score and the CPU seconds of the build."""
    name = name_of(world, seed)
    recording = bench.recorded(world, name, seed, WORLDS[world])
    run_dir, cost = bench.built(f"{name}-small-areas" if options else name, recording, *options)
    return score_run(name, run_dir, truth_of(recording)), cost.cpu_s


def tables(bench: Bench) -> list[Table]:
    """One table."""
    worlds = ["two_doors"] if bench.quick else list(WORLDS)
    jobs: dict[str, list[Future[tuple[Score, float]]]] = {
        world: [bench.jobs.start(judge, bench, world, seed) for seed in bench.seeds] for world in worlds
    }
    if not bench.quick:
        jobs["office_days, areas up to 6 m2"] = [
            bench.jobs.start(judge, bench, "office_days", seed, *SMALL_AREAS) for seed in SMALL_AREAS_SEEDS
        ]
    table = Table(
        "States of places",
        [
            f"`dynmap simulate` with {len(bench.seeds)} seeds and `dynmap build` with default settings; mean over "
            "the seeds, and the 5 and 95 % band of its bootstrap. The index compares the patch of each visit with "
            "what the doors and boxes in that sub-map really were, 1 = the same, 0 = as by chance. A sub-map is "
            "false if no door or box reaches into it. *Objects right*: share of the known states of objects (groups "
            "of cells that switch together) that are right, bound 0.995; *unknown*: share of their states in all "
            "visits that is not known, and of those in whose visits three beams or more reached a quarter of the "
            f"cells (*in view*). The last row is with `segmentation.max_area_m2=6`, {len(SMALL_AREAS_SEEDS)} seeds.",
        ],
        ["world", *_COLUMNS.values(), "CPU s"],
    )

    def row(world: str) -> Row:
        results = [job.result() for job in jobs[world]]
        found = bands_of([score for score, _ in results])
        cells = [banded(found[name], 3 if "share" in name or "index" in name else 1) for name in _COLUMNS]
        return [*cells, f"{sum(seconds for _, seconds in results) / len(results):.1f}"]

    def short(world: str) -> str:
        found = bands_of([job.result()[0] for job in jobs[world]])
        return (
            f"adjusted Rand index {banded(found['adjusted_rand_index'])}, "
            f"right number of states {banded(found['right_number_of_states_share'])}, "
            f"false sub-maps {banded(found['submaps_without_object'], 1)}, "
            f"states of objects right {banded(found['object_states_right_share'])}"
        )

    for world in jobs:
        table.add(world, lambda world=world: row(world))
        table.remark(f"states, {world}", lambda world=world: short(world))
    return [table]
