"""`make bench`: runs the tables and writes RESULTS.md and its short forms in docs/measured.md and the README.

Run it from anywhere: `python tests/bench/run.py`. Tables that take long are only made when `--only` names one of
them alone; each has a section of its own in RESULTS.md, which stays until it is measured again. Recordings of others
are taken from the folder that the environment variable DYNMAP_DATA names, by default ../shared/data beside the
checkout.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench import (
    beams,
    cleaned,
    clustering,
    crowd,
    desks,
    drives,
    filtering,
    kernels,
    kills,
    localization,
    long_recording,
    mapping_cost,
    odometry,
    paper_localization,
    patrol,
    peers,
    real_localization,
    real_logs,
    robustness,
    segmentation,
    sites,
    states,
    verdict,
)
from tests.bench.measured import PROJECT, Jobs, dynmap
from tests.bench.results import RESULTS, page, rewrite_short_forms, section, with_section, with_sections_of
from tests.bench.tables import Table
from tests.bench.worlds import Bench

TABLES: dict[str, Callable[[Bench], list[Table]]] = {
    "trajectories": real_logs.tables,
    "cost": mapping_cost.tables,
    "noise": robustness.rough_tables,
    "odometry": odometry.tables,
    "crowd": crowd.tables,
    "patrol": patrol.tables,
    "filtering": filtering.tables,
    "beams": beams.tables,
    "clustering": clustering.tables,
    "states": states.tables,
    "experiments": segmentation.experiment_tables,
    "desks": desks.tables,
    "drives": drives.tables,
    "localization": localization.tables,
    "real": real_localization.tables,
    "peers": peers.tables,
    "cleaned": cleaned.tables,
    "speed": kernels.tables,
}
LONG_TABLES: dict[str, Callable[[Bench], list[Table]]] = {
    "robustness": robustness.tables,
    "length": patrol.length_tables,
    "segmentation": segmentation.tables,
    "verdict": verdict.tables,
    "paper": paper_localization.tables,
    "kills": kills.tables,
    "sites": sites.tables,
    "long": long_recording.tables,
}


def main() -> int:
    """Parse options, run the tables, write."""
    options = _options()
    started = time.perf_counter()
    folder = options.keep or Path(tempfile.mkdtemp(prefix="dynmap-bench-"))
    folder.mkdir(parents=True, exist_ok=True)
    data = Path(os.environ.get("DYNMAP_DATA", PROJECT.parent / "shared" / "data"))
    bench = Bench(folder.resolve(), data, options.quick, Jobs())
    dynmap("warmup", log=bench.folder / "warmup.txt")
    tables: list[Table] = []
    for name in options.only:
        tables += _made(name, bench)
    minutes = (time.perf_counter() - started) / 60
    old = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else ""
    if not options.quick and options.only == list(TABLES):
        text = page(tables, minutes)
        RESULTS.write_text(with_sections_of(text, old), encoding="utf-8")
        rewrite_short_forms(PROJECT, tables)
    elif not options.quick and len(options.only) == 1 and options.only[0] in LONG_TABLES:
        text = section(options.only[0], tables, minutes)
        RESULTS.write_text(with_section(old, options.only[0], text), encoding="utf-8")
    else:
        text = page(tables, minutes, is_quick=options.quick)
    sys.stdout.write(text)
    if options.keep is None:
        shutil.rmtree(folder)
    return 1 if "**failed**" in text else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Run the tables; with --only or --quick they go to stdout.")
    parser.add_argument(
        "--only",
        type=lambda words: words.split(","),
        default=list(TABLES),
        help=f"some of {','.join(TABLES)}; or one of those that take long: {', '.join(LONG_TABLES)}",
    )
    parser.add_argument("--quick", action="store_true", help="few worlds and seeds, for development")
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="make recordings and runs here, and keep them"
    )
    options = parser.parse_args()
    if unknown := set(options.only) - set(TABLES) - set(LONG_TABLES):
        parser.error(f"unknown table {sorted(unknown)[0]!r}, only {', '.join([*TABLES, *LONG_TABLES])}")
    return options


def _made(name: str, bench: Bench) -> list[Table]:
    """Make tables; a failure becomes a table that says why."""
    try:
        return (TABLES | LONG_TABLES)[name](bench)
    except Exception as err:
        return [Table(name, [f"**failed**: {type(err).__name__}: {err}"], [name])]


if __name__ == "__main__":
    sys.exit(main())
