"""Labels of beams against what they really hit, with ablations at the same poses."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I8, I32
from dynmap_cli.counting.counts import count_beams, end_cells, twists_of
from dynmap_cli.counting.em import FilterParams, filter_beams, occupancy
from dynmap_cli.counting.frames import frame_of_scans
from dynmap_cli.counting.standing import LookParams, filter_by_looks
from dynmap_cli.domain.grid import OCCUPIED
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.scores import Score, ratio
from dynmap_cli.evaluation.truth import Run, Truth, same_scans

PROBABILITY_LIMITS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)
RANGE_LIMITS_M = (0.0, 2.0, 5.0, 10.0, 20.0, math.inf)
_KEPT, _REMOVED, _NO_LABEL = 1, 0, -1
_MOST_MISMATCHES = 0.01


def labels_of(static_probability: F32) -> I8:
    """Label beams by e: kept from 1/2 on, removed below; -1 where there is no e."""
    labels = np.where(static_probability >= 0.5, _KEPT, _REMOVED)
    return np.asarray(np.where(np.isnan(static_probability), _NO_LABEL, labels), dtype=np.int8)


def measures(labels: I8, is_static: B1, is_moving: B1) -> dict[str, float]:
    """SA, DA, HA, precision, recall, F1 of "moving", over the beams that truly are one or the other.

    A beam without a label is neither kept nor found.

    Parameters
    ----------
    labels : (...) int8
        1 = kept, 0 = removed, -1 = no label.
    is_static, is_moving : (...) bool
    """
    kept = int((labels[is_static] == _KEPT).sum())
    found = int((labels[is_moving] == _REMOVED).sum())
    false = int((labels[is_static] == _REMOVED).sum())
    static_accuracy, dynamic_accuracy = ratio(kept, int(is_static.sum())), ratio(found, int(is_moving.sum()))
    precision = ratio(found, found + false)
    return {
        "static_kept_SA": static_accuracy,
        "dynamic_found_DA": dynamic_accuracy,
        "harmonic_HA": harmonic(static_accuracy, dynamic_accuracy),
        "precision": precision,
        "recall": dynamic_accuracy,
        "F1": harmonic(precision if found + false else 0.0, dynamic_accuracy),
    }


def harmonic(a: float, b: float) -> float:
    """Harmonic mean; 0 where both are 0, NaN where one is not known."""
    return 0.0 if a == b == 0.0 else 2.0 * a * b / (a + b)


def plain_map_labels(run: Run, *, threads: int = 1) -> I8:
    """Ablation: count all beams as static, keep those that end in a cell the plain map calls occupied."""
    usable_m, frame = run.settings["usable_range_m"], _frame(run)
    counted = count_beams(run.log, run.poses, frame, usable_m, threads=threads)
    is_wall = occupancy(counted).cells.ravel() == OCCUPIED
    cells = end_cells(run.log, run.poses, frame, usable_m)
    return np.asarray(np.where(cells < 0, _NO_LABEL, is_wall[cells]), dtype=np.int8)


def paper_labels(run: Run, *, threads: int = 1) -> I8:
    """Ablation: the paper to the letter, where only the end cell itself supports a beam."""
    params = FilterParams(
        run.settings["static_prior"], 0, run.settings["usable_range_m"], stop_at_walls=False
    )
    filtered = filter_beams(run.log, run.poses, _frame(run), params, threads=threads)
    return labels_of(filtered.static_probability)


def look_labels(run: Run, *, threads: int = 1) -> dict[str, I8]:
    """Ablations: the filter without looks, without watches, and where grazing beams count as all others."""
    settings = run.settings
    params = FilterParams(
        settings["static_prior"],
        int(settings["support_cells"]),
        settings["usable_range_m"],
        stop_at_walls=bool(settings["stop_at_walls"]),
    )
    twists = twists_of(run.log, run.poses)
    filtered = filter_beams(run.log, run.poses, _frame(run), params, twists=twists, threads=threads)
    labels = {"without looks": labels_of(filtered.static_probability)}
    if settings["look_s"] > 0.0:
        looks = LookParams(look_s=settings["look_s"], look_prior=settings["look_prior"])
        for method, changed in (
            ("without watches", replace(looks, watch_s=0.0)),
            ("with grazing beams", replace(looks, crossing_prior=0.0)),
        ):
            again = filter_by_looks(
                filtered, run.log, run.poses, changed, usable_range_m=params.usable_range_m, twists=twists
            )
            labels[method] = labels_of(again.static_probability)
    return labels


def score_beams(name: str, run: Run, truth: Truth, *, threads: int = 1) -> Score:
    """Measures of the run's labels, of the ablations, and by probability, class and range.

    Beams count that hit something, within the range that the run uses. Those that the run calls unknown are kept
    by it, and count so; the measures without them stand beside.
    """
    mine, theirs = same_scans(run.log.stamps_ns, truth)
    ranges, classes = _matched(run, truth, mine, theirs)
    reach_m = np.minimum(
        run.log.range_limits_m[run.log.geometry_index[mine], 1], run.settings["usable_range_m"]
    )
    in_reach = (ranges <= reach_m[:, None]) & (classes != truth.no_return)
    is_static, is_moving = in_reach & (classes == truth.static), in_reach & (classes == truth.moving)
    methods = {
        "run": labels_of(run.static_probability)[mine],
        **{method: labels[mine] for method, labels in look_labels(run, threads=threads).items()},
        "plain counting": plain_map_labels(run, threads=threads)[mine],
        "paper to the letter": paper_labels(run, threads=threads)[mine],
    }
    values = measures(methods["run"], is_static, is_moving)
    is_known = ~run.is_unknown[mine]
    decided = measures(methods["run"], is_static & is_known, is_moving & is_known)
    details: dict[str, list[dict[str, Any]]] = {
        "methods at the same poses": [
            {"method": method, **measures(labels, is_static, is_moving)} for method, labels in methods.items()
        ]
        + [{"method": "run, without unknown beams", **decided}],
        "reliability": by_probability(run.static_probability[mine], is_static, is_moving),
        "by class": by_class(methods, ~is_known, classes, in_reach, truth),
        "by range": by_range(methods["run"], ranges, is_static, is_moving),
    }
    values["calibration_error"] = calibration_error(run.static_probability[mine], is_static, is_moving)
    missing = 1.0 - ratio(mine.size, truth.trajectory.stamps_ns.size)
    labelled = ratio(int((in_reach & (methods["run"] != _NO_LABEL)).sum()), int(in_reach.sum()))
    return Score(name, (1.0 - missing) * labelled, values, details)


def _matched(run: Run, truth: Truth, mine: Any, theirs: Any) -> tuple[F64, I32]:
    """Ranges and true classes of the scans in both; refuses a truth that cannot be theirs."""
    ranges = np.array(run.log.ranges_m[mine], dtype=np.float64)
    classes = truth.beam_class[theirs]
    problem = ""
    if mine.size == 0:
        problem = "no scan has a time in common with the truth"
    elif classes.shape != ranges.shape:
        problem = f"scans of {ranges.shape[1]} beams, the truth knows {classes.shape[1]}"
    elif ((classes == truth.no_return) & np.isfinite(ranges)).mean() > _MOST_MISMATCHES:
        problem = "beams end where the truth says that nothing came back"
    if problem:
        msg = f"{run.folder}: {problem}. Is it the truth of this recording?"
        raise ArtifactError(msg)
    return ranges, classes


def by_class(
    methods: Mapping[str, I8], is_unknown: B1, classes: I32, in_reach: B1, truth: Truth
) -> list[dict[str, Any]]:
    """Share of the beams of each true class that the run calls unknown, and that each method removed."""
    masks = {
        "static": classes == truth.static,
        "changing": classes >= truth.first_object,
        "mixed": classes == truth.mixed,
        "moving": classes == truth.moving,
    }
    return [
        {
            "class": name,
            "beams": int((mask & in_reach).sum()),
            "unknown": ratio(int((mask & in_reach & is_unknown).sum()), int((mask & in_reach).sum())),
            **{
                f"removed, {method}": ratio(
                    int((labels[mask & in_reach] == _REMOVED).sum()), int((mask & in_reach).sum())
                )
                for method, labels in methods.items()
            },
        }
        for name, mask in masks.items()
    ]


def by_probability(static_probability: F32, is_static: B1, is_moving: B1) -> list[dict[str, Any]]:
    """Reliability: of the beams with an e between two limits, the share that is static, beside the mean of e."""
    rows = []
    for low, high, inside in _bins(static_probability, is_static | is_moving):
        beams, static = int(inside.sum()), int((inside & is_static).sum())
        rows.append(
            {
                "static_probability": f"{low:g}-{high:g}",
                "beams": beams,
                "mean": float(static_probability[inside].mean(dtype=np.float64)) if beams else math.nan,
                "static": ratio(static, beams),
            }
        )
    return rows


def calibration_error(static_probability: F32, is_static: B1, is_moving: B1) -> float:
    """Expected calibration error: mean over the beams of |mean e - share that is static| of their bin."""
    total = weight = 0.0
    for _, _, inside in _bins(static_probability, is_static | is_moving):
        beams = int(inside.sum())
        weight += beams
        total += abs(
            float(static_probability[inside].sum(dtype=np.float64)) - float((inside & is_static).sum())
        )
    return ratio(total, weight)


def _bins(static_probability: F32, counted: B1) -> Iterator[tuple[float, float, B1]]:
    """Yield both limits of each bin and which of the counted beams are in it; the last bin holds 1."""
    for low, high in itertools.pairwise(PROBABILITY_LIMITS):
        below = static_probability <= high if high == PROBABILITY_LIMITS[-1] else static_probability < high
        yield low, high, np.asarray(counted & (static_probability >= low) & below)


def by_range(labels: I8, ranges: F64, is_static: B1, is_moving: B1) -> list[dict[str, Any]]:
    """Measures of the beams of each range."""
    rows = []
    for low, high in itertools.pairwise(RANGE_LIMITS_M):
        inside = (ranges >= low) & (ranges < high)
        static, moving = is_static & inside, is_moving & inside
        if static.any() or moving.any():
            upper = f"{high:g}" if math.isfinite(high) else "more"
            rows.append(
                {
                    "range_m": f"{low:g}-{upper}",
                    "static": int(static.sum()),
                    "moving": int(moving.sum()),
                    **measures(labels, static, moving),
                }
            )
    return rows


def _frame(run: Run) -> Any:
    """The grid of the run."""
    return frame_of_scans(run.log, run.poses, run.settings["usable_range_m"], run.settings["resolution_m"])
