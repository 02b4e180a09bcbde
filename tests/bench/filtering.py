"""Real recordings: what the filter takes out, how sharp the map is with and without it, and pictures to look at."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from dynmap_cli.domain.grid import OCCUPIED
from dynmap_cli.evaluation.sharpness import score_alone
from dynmap_cli.evaluation.truth import read_run
from dynmap_cli.files.pgm import read_map
from tests.bench.measured import PROJECT
from tests.bench.real_logs import AbsentError
from tests.bench.tables import Row, Table, number, percent
from tests.bench.worlds import Bench

GIVEN_POSES = ("--config", PROJECT / "configs" / "recorded_poses.yaml")
STATIC_BOUND = 0.01
PICTURES = Path(__file__).parent
_ALL, _KEPT = "all beams", "filtered"


@dataclass(frozen=True)
class Place:
    """A recording, how it is built, and whether hardly anything moves in it.

    Attributes
    ----------
    file : str
    options : tuple
    is_static : bool
        At most 1 % of the beams may be called dynamic.
    is_drawn : bool
        The picture of what was removed is kept beside this file.
    """

    file: str
    options: tuple[object, ...] = ()
    is_static: bool = False
    is_drawn: bool = False


PLACES = {
    "Intel": Place("benchmark/intel.clf.bz2", is_static=True),
    "Seattle": Place("corrected/seattle-corrected.log.gz", GIVEN_POSES, is_static=True),
    "FHW": Place("corrected/fhw-corrected.log.gz", GIVEN_POSES, is_drawn=True),
    "Wean Hall 1": Place("wean/robotdata1.log.gz", is_drawn=True),
    "Wean Hall 2": Place("wean/robotdata2.log.gz", is_drawn=True),
}


@dataclass(frozen=True)
class Filtered:
    """One built recording: measures with all beams and with those that were kept, at the same poses."""

    values: Mapping[str, Mapping[str, float]]
    cells: Mapping[str, int] = field(default_factory=dict)


def build(bench: Bench, name: str) -> Filtered:
    """Build, measure, keep the picture."""
    place = PLACES[name]
    recording = bench.data / place.file
    if not recording.exists():
        raise AbsentError
    slug = name.lower().replace(" ", "_")
    run_dir, _ = bench.built(f"{slug}-filtered", recording, *place.options)
    if place.is_drawn:
        folder = bench.folder if bench.quick else PICTURES
        shutil.copyfile(run_dir / "figures" / "dynamic.png", folder / picture_of(name))
    run = read_run(run_dir)
    every = np.where(np.isnan(run.static_probability), np.float32(np.nan), np.float32(1.0))
    values = {
        _ALL: score_alone("", replace(run, static_probability=every)).values,
        _KEPT: score_alone("", run).values,
    }
    maps = {_ALL: "unfiltered.yaml", _KEPT: "map.yaml"}
    cells = {
        kind: int((read_map(run_dir / "map" / file)[0].cells == OCCUPIED).sum())
        for kind, file in maps.items()
    }
    return Filtered(values, cells)


def picture_of(name: str) -> str:
    """File of the picture of what was removed."""
    return f"filtered_{name.lower().replace(' ', '_')}.png"


def tables(bench: Bench) -> list[Table]:
    """One table."""
    names = list(PLACES)[1:2] if bench.quick else list(PLACES)
    jobs = {name: bench.jobs.start(build, bench, name) for name in names}
    drawn = ", ".join(f"[{name}]({picture_of(name)})" for name, place in PLACES.items() if place.is_drawn)
    table = Table(
        "Real recordings: what the filter takes out",
        [
            "`dynmap build LOG` with default settings; Seattle and FHW with configs/recorded_poses.yaml. Measures of "
            "`dynmap evaluate` that need no truth, at the poses found, with all beams and with those that were kept: "
            "spread of the end points across the local line; log-likelihood (Eq. 1.1) of every tenth scan in the map "
            "of the others, beams on people included, which no filtered map foretells; share of the end points that "
            "other beams look through; occupied cells. Intel and Seattle "
            f"are almost static: bound {100 * STATIC_BOUND:.0f} % removed, what misses it is **bold**. "
            f"Every end point beside the filtered map, the removed ones in colour: {drawn}.",
        ],
        [
            "recording",
            "beams removed",
            "line, mm, all",
            "kept",
            "foretold, nats per beam, all",
            "kept",
            "looked through, all",
            "kept",
            "occupied cells, all",
            "kept",
        ],
    )
    for name, job in jobs.items():
        table.add(name, lambda name=name, job=job: _row(PLACES[name], job))

    def worst() -> str:
        try:
            static = [job.result() for name, job in jobs.items() if PLACES[name].is_static]
        except AbsentError:
            return "skipped: no recording"
        return percent(max(one.values[_KEPT]["removed_share"] for one in static), 2)

    table.remark("Intel and Seattle, beams called dynamic, worst", worst)
    return [table]


def _row(place: Place, job: Future[Filtered]) -> Row:
    try:
        one = job.result()
    except AbsentError:
        return ["skipped: no recording"]
    every, kept = one.values[_ALL], one.values[_KEPT]
    removed = percent(kept["removed_share"], 2)
    is_too_many = place.is_static and kept["removed_share"] > STATIC_BOUND
    through = kept["looked_through_share_of_kept"]
    return [
        f"**{removed}**" if is_too_many else removed,
        number(every["line_thickness_mm"], 1),
        number(kept["line_thickness_mm"], 1),
        number(every["held_out_log_likelihood_per_beam"]),
        number(kept["held_out_log_likelihood_per_beam"]),
        percent(every["looked_through_share"]),
        percent(through),
        f"{one.cells[_ALL]}",
        f"{one.cells[_KEPT]}",
    ]
