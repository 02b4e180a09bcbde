"""Real recordings with each setting of mapping halved and doubled, with half the beams, and with more noise."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future
from dataclasses import asdict

from dynmap_cli.mapping.loops import LoopParams
from dynmap_cli.scan_matching.matcher import FrontEndParams
from tests.bench.mapped import Mapped, Variant, mapped, relations_m
from tests.bench.real_logs import LOGS, AbsentError, RealLog
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench

BOUNDS_M = {"Intel": 0.02, "fr079": 0.05}
_SETTINGS: dict[str, tuple[float, float]] = {
    "resolution_m": (0.025, 0.1),
    "static_prior": (0.975, 0.9),
    "support_cells": (0, 2),
    "stop_label_share": (0.0005, 0.002),
    "max_rounds": (1, 4),
    "usable_range_m": (15.0, 60.0),
}
"""Settings of `map` that are numbers and act before the poses are final (`look_s` and `look_prior` act after).

Of the prior, what it lacks to 1 is halved and doubled.
"""
_OF_THE_FILTER = ("resolution_m", "static_prior", "support_cells", "stop_label_share", "max_rounds")
_COUNTS = ("n_keys", "n_partners")
_FACTORS = ("independent_share",)
_ABOUT = (
    "Mean translation error of the relations, m. Bound: Intel below 0.02 m, fr079 below 0.05 m; what misses it "
    "is **bold**. Only the mapping room runs, on scans ingested once."
)


def recordings() -> list[RealLog]:
    """Those with a bound."""
    return [log for log in LOGS if log.name in BOUNDS_M]


def rough_variants() -> list[Variant]:
    """As recorded, with half the beams, with noise; all settings at their defaults."""
    names = ("as recorded", "every second beam", "2 cm more range noise")
    return [Variant(name, perturbation=name) for name in names]


def changed_variants() -> list[Variant]:
    """Every setting halved and doubled; those that do not concern the filter with one registration of all beams."""
    found = [Variant("one registration", filtered=False)]
    for name, values in _SETTINGS.items():
        filtered = name in _OF_THE_FILTER
        found += [Variant(f"map.{name} = {one:g}", map={name: one}, filtered=filtered) for one in values]
    for name, value in asdict(FrontEndParams()).items():
        for one in halved_and_doubled(name, value):
            found.append(Variant(f"front end, {name} = {one:g}", front={name: one}, filtered=False))
    for name, value in asdict(LoopParams()).items():
        for one in halved_and_doubled(name, value):
            found.append(Variant(f"loops, {name} = {one:g}", loops={name: one}, filtered=False))
    return found


def halved_and_doubled(name: str, value: float) -> tuple[float, float]:
    """Half and double of a parameter; of a share of a half or more, what it lacks to 1 is halved and doubled."""
    if name in _COUNTS:
        return int(value) // 2, int(value) * 2
    is_share = name not in _FACTORS and not name.endswith(("_m", "_rad"))
    if is_share and value >= 0.5:
        missing = 1.0 - value
        return round(1.0 - missing / 2.0, 6), round(1.0 - min(2.0 * missing, 0.95), 6)
    return value / 2.0, value * 2.0


def tables(bench: Bench) -> list[Table]:
    """The long table: every setting."""
    variants = [*rough_variants(), *changed_variants()]
    return [
        _table(
            bench,
            "Robustness: every setting halved and doubled",
            [
                f"{_ABOUT} Settings that do not concern the filter are tried with one registration of all beams. Of a "
                "share of a half or more, what it lacks to 1 is halved and doubled.",
            ],
            variants[:6] if bench.quick else variants,
        )
    ]


def rough_tables(bench: Bench) -> list[Table]:
    """The short table: half the beams, more noise."""
    return [_table(bench, "Robustness: fewer beams, more noise", [_ABOUT], rough_variants())]


def _table(bench: Bench, title: str, about: list[str], variants: list[Variant]) -> Table:
    table = Table(title, about, ["what differs"])
    logs = recordings()
    for log in logs:
        table.header += [f"{log.name}, m", "loops", "lost scans", "contradictions", "CPU s"]
    jobs = {
        (variant.name, log.name): bench.jobs.start(_map_log, bench, log, variant)
        for variant in variants
        for log in logs
    }
    for variant in variants:
        table.add(
            variant.name,
            lambda name=variant.name: [c for log in logs for c in _cells(bench, log, jobs[name, log.name])],
        )
    for log in logs:
        outcomes = {variant.name: jobs[variant.name, log.name] for variant in variants}
        table.remark(
            f"{log.name}, {title[0].lower()}{title[1:]}",
            lambda log=log, outcomes=outcomes: _worst(bench, log, outcomes),
        )
    return table


def _map_log(bench: Bench, log: RealLog, variant: Variant) -> Mapped:
    recording = bench.data / "benchmark" / log.file
    if not recording.exists():
        raise AbsentError
    return mapped(bench, log.name, recording, variant)


def _error_m(bench: Bench, log: RealLog, outcome: Mapped) -> float:
    return relations_m(outcome.trajectory, bench.data / "benchmark" / str(log.relations))


def _cells(bench: Bench, log: RealLog, job: Future[Mapped]) -> Row:
    try:
        outcome = job.result()
    except AbsentError:
        return ["skipped: no recording", "", "", "", ""]
    except Exception as err:
        return [f"**failed**: {err}".replace("|", "/").replace("\n", " "), "", "", "", ""]
    error_m = _error_m(bench, log, outcome)
    found = outcome.found
    cell = number(error_m, 4) if error_m < BOUNDS_M[log.name] else f"**{number(error_m, 4)}**"
    counts = [f"{found['loops']}", f"{found['lost_scans']}", number(found["contradictions"])]
    return [cell, *counts, f"{outcome.cost.cpu_s:.1f}"]


def _worst(bench: Bench, log: RealLog, jobs: Mapping[str, Future[Mapped]]) -> str:
    """How many variants keep the bound, and the worst."""
    try:
        errors = {name: _error_m(bench, log, job.result()) for name, job in jobs.items()}
    except AbsentError:
        return "skipped: no recording"
    kept = sum(error_m < BOUNDS_M[log.name] for error_m in errors.values())
    worst = max(errors, key=lambda name: errors[name])
    return f"{kept} of {len(errors)} below {BOUNDS_M[log.name]} m; worst {errors[worst]:.4f} m: {worst}"
