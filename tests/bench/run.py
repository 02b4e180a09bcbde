"""`make bench`: runs the tables and writes RESULTS.md and the short form in the README.

Run it from anywhere: `python tests/bench/run.py`. Recordings of others are taken from the folder that the
environment variable DYNMAP_DATA names, by default ../shared/data beside the checkout.
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

from tests.bench import beams, kernels, localization, machine, peers, real_logs, states
from tests.bench.measured import PROJECT, Jobs, dynmap
from tests.bench.tables import Table
from tests.bench.worlds import Bench

TABLES: dict[str, Callable[[Bench], list[Table]]] = {
    "trajectories": real_logs.tables,
    "beams": beams.tables,
    "states": states.tables,
    "localization": localization.tables,
    "peers": peers.tables,
    "speed": kernels.tables,
}
RESULTS = Path(__file__).with_name("RESULTS.md")
_BEGIN, _END = "<!-- bench:begin -->", "<!-- bench:end -->"


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
    text = "\n".join(_page(tables, minutes, options))
    if options.quick or set(options.only) != set(TABLES):
        sys.stdout.write(text)
    else:
        RESULTS.write_text(text, encoding="utf-8")
        rewrite_short_form(PROJECT / "README.md", tables)
        sys.stdout.write(f"{RESULTS} written after {minutes:.1f} min\n")
    if options.keep is None:
        shutil.rmtree(folder)
    return 1 if "**failed**" in text else 0


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Run the tables; with --only or --quick they go to stdout.")
    parser.add_argument(
        "--only",
        type=lambda words: words.split(","),
        default=list(TABLES),
        help=f"some of {','.join(TABLES)}",
    )
    parser.add_argument("--quick", action="store_true", help="few worlds and seeds, for development")
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="make recordings and runs here, and keep them"
    )
    options = parser.parse_args()
    if unknown := set(options.only) - set(TABLES):
        parser.error(f"unknown table {sorted(unknown)[0]!r}, only {', '.join(TABLES)}")
    return options


def _made(name: str, bench: Bench) -> list[Table]:
    """Make tables; a failure becomes a table that says why."""
    try:
        return TABLES[name](bench)
    except Exception as err:
        return [Table(name, [f"**failed**: {type(err).__name__}: {err}"], [name])]


def _page(tables: list[Table], minutes: float, options: argparse.Namespace) -> list[str]:
    lines = [
        "# Measured",
        "",
        "Written by `make bench`; numbers as they came out, good or bad.",
        "",
        *machine.describe(),
        f"- the bench ran {minutes:.1f} min{', quick' if options.quick else ''}; two processes side "
        f"by side with one "
        "thread each, so times are CPU seconds of the whole process, not wall time",
        "",
    ]
    for table in tables:
        lines += table.lines()
    return lines


def rewrite_short_form(readme: Path, tables: list[Table]) -> None:
    """Replace what is between the markers in the README."""
    text = readme.read_text(encoding="utf-8")
    rows = [pair for table in tables for pair in table.short]
    lines = ["| what | result |", "|---|---|", *(f"| {what} | {result} |" for what, result in rows)]
    if _BEGIN not in text or _END not in text:
        text += f"\n## Measured\n\n{_BEGIN}\n{_END}\n"
    head, _, rest = text.partition(_BEGIN)
    _, _, tail = rest.partition(_END)
    readme.write_text("\n".join([head + _BEGIN, *lines, _END + tail]), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
