"""People who are at the same desk on most days: is the desk a sub-map, and are its states somebody and nobody?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from dynmap_cli.domain.poses import inverse, transform_points
from dynmap_cli.evaluation.states import LearnedStates, adjusted_rand_index, read_learned_states
from dynmap_cli.evaluation.truth import Truth
from tests.bench.measured import WORLDS
from tests.bench.tables import Row, Table, number
from tests.bench.worlds import Bench, truth_of

_WORLD = "two_desks"
_LEAST_DAYS = 2


def tables(bench: Bench) -> list[Table]:
    """One table."""
    jobs = {seed: bench.jobs.start(_judge, bench, seed) for seed in bench.seeds}
    table = Table(
        "People at their desks",
        [
            f"`configs/worlds/{_WORLD}.yaml`: eight days of two visits; two people are at their desks on five of them, "
            "somebody walks about and somebody stands 20 s once. Supports: visits that saw each state of a desk; the "
            "index compares them with who was there. Without cause: sub-maps that hold no desk.",
        ],
        ["seed", "desks", "sub-maps", "without cause", "supports", "visits with somebody, without", "index"],
    )
    for seed, job in jobs.items():
        table.add(f"{seed}", job.result)
    return [table]


def _judge(bench: Bench, seed: int) -> Row:
    name = f"{_WORLD}-seed-{seed}"
    recording = bench.recorded(_WORLD, name, seed)
    run_dir, _ = bench.built(name, recording)
    content = yaml.safe_load((WORLDS / f"{_WORLD}.yaml").read_text(encoding="utf-8"))
    truth = truth_of(recording)
    learned = read_learned_states(run_dir, truth)
    desks = _desks(content)
    supports, true_counts, indices, found = [], [], [], set()
    for at, spans in desks.items():
        submap_id = _submap_at(at, math.radians(content["turn_deg"]), learned)
        if submap_id is None:
            supports.append("-")
            continue
        found.add(submap_id)
        own = [visit for visit in learned.visits if visit.submap_id == submap_id]
        there = [_is_there((visit.start_ns, visit.end_ns), spans, truth) for visit in own]
        known = [
            (visit.patch, is_there)
            for visit, is_there in zip(own, there, strict=True)
            if visit.patch is not None
        ]
        patches = [patch for patch, _ in known]
        supports.append(" and ".join(f"{patches.count(patch)}" for patch in sorted(set(patches))))
        true_counts.append(f"{sum(there)} and {len(there) - sum(there)}")
        indices.append(adjusted_rand_index(patches, [is_there for _, is_there in known]))
    return [
        f"{len(desks)}",
        f"{len(learned.submaps)}",
        f"{len(learned.submaps) - len(found)}",
        ", ".join(supports),
        ", ".join(true_counts),
        ", ".join(number(index) for index in indices),
    ]


def _desks(content: Mapping[str, Any]) -> dict[tuple[float, float], list[tuple[float, float]]]:
    """Places at which somebody stands on several days, with the seconds from and to."""
    places: dict[tuple[float, float], list[tuple[float, float]]] = {}
    for mover in content["movers"]:
        if mover["does"] == "stand":
            places.setdefault(tuple(mover["at"]), []).append((mover["from_s"], mover["to_s"]))
    return {at: spans for at, spans in places.items() if len(spans) >= _LEAST_DAYS}


def _submap_at(at: tuple[float, float], turn_rad: float, learned: LearnedStates) -> int | None:
    """The sub-map that holds a place of the scenario, which is turned against the frame of the truth."""
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    turned = np.array([[cos * at[0] - sin * at[1], sin * at[0] + cos * at[1]]])
    (place,) = transform_points(inverse(learned.truth_from_map), turned)
    for submap in learned.submaps:
        if (np.abs(place - submap.center_m) <= np.array(submap.size_m) / 2.0).all():
            return submap.submap_id
    return None


def _is_there(span_ns: tuple[int, int], spans: Sequence[tuple[float, float]], truth: Truth) -> bool:
    """Whether somebody was there in the middle of a visit."""
    middle_s = (0.5 * (span_ns[0] + span_ns[1]) - float(truth.trajectory.stamps_ns[0])) * 1e-9
    return any(first <= middle_s <= last for first, last in spans)
