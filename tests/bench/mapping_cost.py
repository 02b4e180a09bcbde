"""What each part of mapping costs on a real recording."""

from __future__ import annotations

from tests.bench.map_once import CALIBRATION, PARTS, REST
from tests.bench.mapped import Mapped, Variant, ingested, mapped
from tests.bench.real_logs import LOGS, AbsentError, RealLog
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench

_PARTS = [CALIBRATION, *dict.fromkeys(part for _, _, part in PARTS), REST]


def measure(bench: Bench, log: RealLog) -> tuple[float, Mapped]:
    """CPU seconds of ingest, and the mapping room's."""
    recording = bench.data / "benchmark" / log.file
    if not recording.exists():
        raise AbsentError
    _, ingest_s = ingested(bench, log.name, recording)
    return ingest_s, mapped(bench, log.name, recording, Variant("as recorded"))


def tables(bench: Bench) -> list[Table]:
    """One table."""
    logs = LOGS[2:] if bench.quick else LOGS
    jobs = {log.name: bench.jobs.start(measure, bench, log) for log in logs}
    table = Table(
        "Real recordings: cost inside mapping",
        [
            "CPU seconds of each part with one thread and default settings, as recorded, compilation not included. "
            "*Calibration*: the first pass over the first scans; *fitting poses*: key scans on the local maps around "
            "them; *rest*: reading the columns, frames, comparing rounds. *Process*: mapping alone, start included. "
            "Aims for Intel: reading 1 s, front end 2 s, loops and graph 2 s.",
        ],
        ["log", "scans", "reading the log", *_PARTS, "process", "peak MB", "CPU ms per scan"],
    )

    def row(name: str) -> Row:
        try:
            ingest_s, one = jobs[name].result()
        except AbsentError:
            return ["skipped: no recording"]
        seconds, scans = one.found["seconds"], one.found["scans"]
        spent = [number(seconds.get(part, 0.0), 2) for part in _PARTS]
        total = sum(seconds.values()) + ingest_s
        return [
            f"{scans}", number(ingest_s, 2), *spent, f"{one.cost.cpu_s:.1f}", f"{one.cost.peak_mb:.0f}",
            number(1000 * total / scans, 2),
        ]  # fmt: skip

    for log in logs:
        table.add(log.name, lambda name=log.name: row(name))
    return [table]
