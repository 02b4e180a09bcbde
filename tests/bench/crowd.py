"""A hall full of people: the path with and without the filter of moving beams."""

from __future__ import annotations

from dataclasses import dataclass

from dynmap_cli.files.trajectory import read_tum
from tests.bench.mapped import Mapped, Variant, ate_m, mapped
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_folder

ATE_BOUND_M, TIMES_BETTER = 0.03, 4.0


@dataclass(frozen=True)
class Compared:
    """One recording, mapped with and without the filter."""

    filtered: Mapped
    filtered_m: float
    plain_m: float


def compare(bench: Bench, seed: int) -> Compared:
    """Simulate, map twice."""
    name = f"crowd-seed-{seed}"
    recording = bench.recorded("crowd", name, seed)
    truth = read_tum(truth_folder(recording) / "trajectory.tum")
    filtered = mapped(bench, name, recording, Variant("as recorded"))
    plain = mapped(bench, name, recording, Variant("no filter", filtered=False))
    return Compared(filtered, ate_m(filtered.trajectory, truth), ate_m(plain.trajectory, truth))


def _row(one: Compared) -> Row:
    times = one.plain_m / one.filtered_m
    return [
        number(one.filtered_m, 4) if one.filtered_m <= ATE_BOUND_M else f"**{number(one.filtered_m, 4)}**",
        number(one.plain_m, 4),
        number(times, 2) if times >= TIMES_BETTER else f"**{number(times, 2)}**",
        ", ".join(f"{100 * share:.1f} %" for share in one.filtered.found["dynamic_share"]),
        f"{one.filtered.found['lost_scans']}",
        f"{one.filtered.found['loops']}",
        f"{one.filtered.cost.cpu_s:.1f}",
    ]


def tables(bench: Bench) -> list[Table]:
    """One table."""
    jobs = {seed: bench.jobs.start(compare, bench, seed) for seed in bench.seeds}
    table = Table(
        "Crowd: path with and without the filter",
        [
            "The world `crowd`: thirty people in a hall; the building is the same, people and noise differ with "
            "the seed. ATE in m after alignment with default settings, and from one "
            "registration of all beams. Bounds: 0.03 m, and at least 4 times better than without; what "
            "misses them is **bold**.",
        ],
        [
            "seed",
            "ATE m",
            "without filter",
            "times better",
            "moving, per round",
            "lost scans",
            "loops",
            "CPU s",
        ],
    )
    for seed, job in jobs.items():
        table.add(f"{seed}", lambda job=job: _row(job.result()))

    def worst() -> str:
        known = [job.result() for job in jobs.values()]
        times = [one.plain_m / one.filtered_m for one in known]
        return (
            f"{max(one.filtered_m for one in known):.4f} m, {min(times):.1f} times better than without filter"
        )

    table.remark(f"crowd, ATE, worst of {len(jobs)} seeds", worst)
    return [table]
