"""Crowds: the path with and without the filter of moving beams."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

from dynmap_cli.evaluation.scores import ratio
from tests.bench.mapped import Mapped, Variant, ate_m, mapped
from tests.bench.tables import Row, Table, number, percent
from tests.bench.worlds import Bench, truth_of

ATE_BOUND_M, TIMES_BETTER = 0.03, 4.0
CROWDED_SHARE = 1.0 / 3.0
WORLDS: Mapping[str, Mapping[str, Any]] = {"crowd": {}, "concourse": {}, "guided_tour": {}}


@dataclass(frozen=True)
class Compared:
    """One recording, mapped with and without the filter.

    Attributes
    ----------
    people_share : float
        Of the beams with an end point, those that end on people.
    filtered, plain : Mapped
    filtered_m, plain_m : float
        ATE.
    """

    people_share: float
    filtered: Mapped
    plain: Mapped
    filtered_m: float
    plain_m: float

    @property
    def is_crowded(self) -> bool:
        """Whether the bounds are for it."""
        return self.people_share >= CROWDED_SHARE


def compare(bench: Bench, world: str, seed: int) -> Compared:
    """Simulate, map twice."""
    name = f"{world}-seed-{seed}"
    recording = bench.recorded(world, name, seed, WORLDS[world])
    truth = truth_of(recording)
    filtered = mapped(bench, name, recording, Variant("as recorded"))
    plain = mapped(bench, name, recording, Variant("no filter", filtered=False))
    errors = [ate_m(one.trajectory, truth.trajectory) for one in (filtered, plain)]
    people = ratio(
        int((truth.beam_class == truth.moving).sum()), int((truth.beam_class != truth.no_return).sum())
    )
    return Compared(people, filtered, plain, *errors)


def _row(job: Future[Compared]) -> Row:
    one = job.result()
    times = one.plain_m / one.filtered_m
    meets = number(one.filtered_m, 4), number(times, 2)
    misses = one.filtered_m > ATE_BOUND_M, one.is_crowded and times < TIMES_BETTER
    error, better = (f"**{cell}**" if bad else cell for cell, bad in zip(meets, misses, strict=True))
    found, plain = one.filtered.found, one.plain.found
    return [
        percent(one.people_share),
        error,
        number(one.plain_m, 4),
        better,
        ", ".join(percent(share) for share in found["dynamic_share"]),
        f"{found['lost_scans']}, {plain['lost_scans']}",
        f"{found['loops']}, {plain['loops']}",
        f"{one.filtered.cost.cpu_s:.1f}",
    ]


def tables(bench: Bench) -> list[Table]:
    """One table."""
    pairs = [(world, seed) for world in WORLDS for seed in bench.seeds]
    jobs = {(w, s): bench.jobs.start(compare, bench, w, s) for w, s in pairs}
    table = Table(
        "Crowds: path with and without the filter",
        [
            "Worlds of `configs/worlds`; the building is the same, people and noise differ with the seed. `crowd`: "
            "thirty people who wander about in a hall. `concourse`: most people stream past one way, as fast as the "
            "robot, and eight go with it. `guided_tour`: a dozen go with the robot, all around it, and others wander "
            "about. ATE in m after alignment with default settings, and from one registration of all beams. Bounds: "
            "0.03 m, and where a third of the beams ends on people at least 4 times better than without; what misses "
            "them is **bold**. People who wander each on their own way do not harm registration without a filter, as "
            "its kernels are robust, whatever their number; people who go the same way together, or with the robot, "
            "carry it along.",
        ],
        [
            "world, seed",
            "beams on people",
            "ATE m",
            "without filter",
            "times better",
            "moving, per round",
            "lost scans, with and without",
            "loops, with and without",
            "CPU s",
        ],
    )
    for (world, seed), job in jobs.items():
        table.add(f"{world}, {seed}", lambda job=job: _row(job))

    def worst() -> str:
        known = [job.result() for job in jobs.values()]
        known = [one for one in known if one.is_crowded]
        times = [one.plain_m / one.filtered_m for one in known]
        return (
            f"{max(one.filtered_m for one in known):.4f} m, {min(times):.1f} times better than without filter"
        )

    table.remark("a third of the beams on people, ATE, worst of worlds and seeds", worst)
    return [table]
