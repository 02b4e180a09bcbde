"""Poses, states and verdicts of a localization against the truth."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import B1, F64, I64
from dynmap_cli.domain.patches import SURE
from dynmap_cli.domain.poses import Trajectory, compose, wrap_angle
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.association import known_poses, nearest_stamp
from dynmap_cli.evaluation.believed_states import Believed, combination_accuracy, state_measures
from dynmap_cli.evaluation.object_beliefs import (
    BelievedObject,
    ObjectShares,
    object_measures,
    parse_beliefs,
)
from dynmap_cli.evaluation.scores import Score, mean_or_nan, ratio
from dynmap_cli.evaluation.states import LearnedStates
from dynmap_cli.evaluation.truth import Truth, same_scans
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.documents import MAX_TABLE_BYTES, read_text
from dynmap_cli.files.npy import Column, read_npz
from dynmap_cli.files.trajectory import parse_stamp, read_tum

GOOD_M, GOOD_RAD, GOOD_SHARE = 0.5, math.radians(10.0), 0.95
"""A pose is right within these; a run succeeds if this share of its poses is, from convergence on."""
SETTLED_S = 3.0
"""The filter has converged when all poses of so many seconds are right."""
_CLOUDS = {
    "stamps_ns": Column("<i8", (None,)),
    "counts": Column("<i8", (None,)),
    "poses": Column("<f4", (None, 3)),
    "weights": Column("<f4", (None,)),
}
_MOST_BYTES = 4 * 2**30


@dataclass(frozen=True, slots=True)
class Clouds:
    """Weighted particles of every update.

    Attributes
    ----------
    stamps_ns : (n_updates,) int64
    update : (n,) int64
        Which update a particle belongs to.
    poses : (n, 3) float64
    weights : (n,) float64
    """

    stamps_ns: I64
    update: I64
    poses: F64
    weights: F64


@dataclass(frozen=True, slots=True)
class Localized:
    """The files of a localization.

    Attributes
    ----------
    trajectory : Trajectory
    believed : dict of int to Believed
        By sub-map.
    verdict_stamps_ns : (n,) int64
    says_lost : (n,) bool
    clouds : Clouds or None
        None where the particles were not saved.
    objects : dict of (int, int) to BelievedObject
        By sub-map and object.
    """

    trajectory: Trajectory
    believed: Mapping[int, Believed]
    verdict_stamps_ns: I64
    says_lost: B1
    clouds: Clouds | None
    objects: Mapping[tuple[int, int], BelievedObject] = field(default_factory=dict)


def read_localized(folder: Path) -> Localized:
    """Read trajectory.tum, states.csv, health.csv and, where they are there, objects.csv and particles.npz.

    Raises
    ------
    ArtifactError
        If a file is missing or damaged.
    """
    trajectory = read_tum(folder / "trajectory.tum")
    with refusing_damage(
        f"{folder}: not the result of `dynmap localize`", "Run it again with --force.", ArtifactError
    ):
        states = _rows(folder / "states.csv")
        health = _rows(folder / "health.csv")
        objects, particles = folder / "objects.csv", folder / "particles.npz"
        return Localized(
            trajectory,
            _most_believed(states),
            np.array([parse_stamp(row["stamp_s"]) for row in health], dtype=np.int64),
            np.array([row["verdict"] == "lost" for row in health], dtype=bool),
            _read_clouds(particles) if particles.exists() else None,
            parse_beliefs(_rows(objects)) if objects.exists() else {},
        )


def _rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(read_text(path, MAX_TABLE_BYTES))))


def _read_clouds(path: Path) -> Clouds:
    arrays = read_npz(path, _CLOUDS, max_bytes=_MOST_BYTES)
    counts, poses, weights = arrays["counts"], arrays["poses"], arrays["weights"]
    if counts.size != arrays["stamps_ns"].size or (counts < 0).any():
        msg = "counts are not one per update"
        raise ValueError(msg)
    if not counts.sum() == poses.shape[0] == weights.size or not np.isfinite(poses).all():
        msg = f"{counts.sum()} particles by their counts, but {poses.shape[0]} poses, or some that are not finite"
        raise ValueError(msg)
    update = np.repeat(np.arange(counts.size), counts)
    return Clouds(arrays["stamps_ns"], update, poses.astype(np.float64), weights.astype(np.float64))


def _most_believed(rows: list[dict[str, str]]) -> dict[int, Believed]:
    """Keep the patch of highest probability of each stamp and sub-map."""
    best: dict[int, dict[int, tuple[float, int]]] = {}
    for row in rows:
        submap, stamp = int(row["submap"]), parse_stamp(row["stamp_s"])
        candidate = (float(row["probability"]), int(row["patch"]))
        of_submap = best.setdefault(submap, {})
        if candidate[0] > of_submap.get(stamp, (-1.0, 0))[0]:
            of_submap[stamp] = candidate
    result = {}
    for submap, by_stamp in best.items():
        stamps = sorted(by_stamp)
        probability, patches = zip(*(by_stamp[stamp] for stamp in stamps), strict=True)
        result[submap] = Believed(
            np.array(stamps, dtype=np.int64), np.array(patches, dtype=np.int64), np.array(probability)
        )
    return result


def pose_errors(localized: Localized, truth: Truth, truth_from_map: F64) -> tuple[F64, F64]:
    """Position (m) and heading (rad) error at each scan of the truth, (n_scans,); NaN where there is no pose."""
    known = known_poses(localized.trajectory)
    mine, theirs = same_scans(known.stamps_ns, truth)
    position_m, heading_rad = np.full((2, truth.trajectory.stamps_ns.size), np.nan)
    there = compose(truth_from_map, known.poses[mine])
    true = truth.trajectory.poses[theirs]
    position_m[theirs] = np.hypot(there[:, 0] - true[:, 0], there[:, 1] - true[:, 1])
    heading_rad[theirs] = np.abs(wrap_angle(there[:, 2] - true[:, 2]))
    return position_m, heading_rad


def weighted_errors(clouds: Clouds, truth: Truth, truth_from_map: F64) -> F64:
    """(n_updates,) weighted mean distance of the particles from the true pose (paper, 1.5); NaN without truth."""
    scan = nearest_stamp(truth.trajectory.stamps_ns, clouds.stamps_ns)
    there = compose(truth_from_map, clouds.poses)
    true = truth.trajectory.poses[scan[clouds.update]]
    distance = np.hypot(there[:, 0] - true[:, 0], there[:, 1] - true[:, 1])
    count = clouds.stamps_ns.size
    total = np.bincount(clouds.update, clouds.weights, count)
    errors = np.bincount(clouds.update, clouds.weights * distance, count) / np.where(total > 0, total, np.nan)
    return np.asarray(np.where(scan >= 0, errors, np.nan))


def first_settled(stamps_ns: I64, is_good: B1) -> int | None:
    """First scan from which every pose of the next seconds is right; None where there is none."""
    end = np.searchsorted(stamps_ns, stamps_ns + round(SETTLED_S * 1e9), side="right")
    bad_before = np.concatenate([[0], np.cumsum(~is_good)])
    settled = bad_before[end] == bad_before[:-1]
    settled &= stamps_ns + round(SETTLED_S * 1e9) <= stamps_ns[-1]
    return int(np.argmax(settled)) if settled.any() else None


def score_localization(
    name: str,
    localized: Localized,
    truth: Truth,
    learned: LearnedStates | None = None,
    map_truth: Truth | None = None,
    object_shares: ObjectShares | None = None,
) -> Score:
    """Errors, success, convergence, states and verdicts.

    Parameters
    ----------
    name : str
    localized : Localized
    truth : Truth
        Of the recording that was localized.
    learned, map_truth : LearnedStates and Truth, optional
        Patch map it was localized in, and the truth of the recording that this was built from. Without them the
        poses are taken to be in the frame of the truth, and nothing is said about states.
    object_shares : ObjectShares, optional
        Of the objects of that patch map; without them nothing is said about objects.
    """
    frame = np.zeros(3) if learned is None else learned.truth_from_map
    position_m, heading_rad = pose_errors(localized, truth, frame)
    stamps = truth.trajectory.stamps_ns
    is_good = np.asarray((position_m < GOOD_M) & (heading_rad < GOOD_RAD))
    start = first_settled(stamps, is_good)
    after = slice(start, None) if start is not None else slice(0, 0)
    good_share = mean_or_nan(is_good[after].astype(np.float64))
    measured_m, measured_rad = position_m[after], heading_rad[after]
    values = {
        "success": float(start is not None and good_share >= GOOD_SHARE),
        "time_to_converge_s": math.nan if start is None else float(stamps[start] - stamps[0]) * 1e-9,
        "right_share_after": good_share,
        "position_error_mean_m": _mean_of_known(measured_m),
        "position_error_p95_m": _quantile(measured_m, 0.95),
        "heading_error_mean_deg": math.degrees(_mean_of_known(measured_rad)),
    }
    if localized.clouds is not None:
        values["weighted_particle_error_mean_m"] = _mean_of_known(
            weighted_errors(localized.clouds, truth, frame)
        )
    values |= _verdicts(localized, stamps, is_good)
    if learned is not None and map_truth is not None:
        values |= state_measures(localized.believed, truth, learned, map_truth)
        if object_shares is not None:
            values["combination_accuracy"] = combination_accuracy(
                localized.believed, localized.objects, object_shares, truth, learned, map_truth
            )
    if object_shares is not None:
        values |= object_measures(localized.objects, object_shares, truth, SURE)
    seconds = (stamps - stamps[0]) * 1e-9
    series = {
        "seconds": seconds,
        "position error, m": position_m,
        "heading error, deg": np.degrees(heading_rad),
    }
    return Score(name, float(np.isfinite(position_m).mean()), values, series=series)


def _verdicts(localized: Localized, stamps_ns: I64, is_good: B1) -> dict[str, float]:
    """How often "lost" was said of a right pose, and not said of a wrong one."""
    scan = nearest_stamp(stamps_ns, localized.verdict_stamps_ns)
    right, says_lost = is_good[scan[scan >= 0]], localized.says_lost[scan >= 0]
    return {
        "false_alarm_share": ratio(int((says_lost & right).sum()), int(right.sum())),
        "lost_share": ratio(int((~right).sum()), int(right.size)),
        "lost_found_share": ratio(int((says_lost & ~right).sum()), int((~right).sum())),
    }


def _mean_of_known(errors: F64) -> float:
    return mean_or_nan(errors[np.isfinite(errors)])


def _quantile(errors: F64, share: float) -> float:
    known = errors[np.isfinite(errors)]
    return float(np.quantile(known, share)) if known.size else math.nan
