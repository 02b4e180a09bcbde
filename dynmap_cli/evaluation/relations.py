"""Relative poses checked by hand: the metric of Kuemmerle et al., Autonomous Robots 27 (2009)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import F64, I64
from dynmap_cli.domain.poses import Trajectory, between
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.association import known_poses, nearest_stamp
from dynmap_cli.evaluation.scores import Score
from dynmap_cli.files.damage import reason
from dynmap_cli.files.documents import MAX_TABLE_BYTES, read_text
from dynmap_cli.files.trajectory import parse_stamp

_FARTHEST = 1e9


@dataclass(frozen=True, slots=True)
class Relations:
    """Where the robot was at one time, seen from where it was at another.

    Attributes
    ----------
    first_ns, second_ns : (n,) int64
    poses : (n, 3) float64
        first_from_second: x, y in metres, yaw in radians.
    """

    first_ns: I64
    second_ns: I64
    poses: F64


def read_relations(path: Path) -> Relations:
    """Read lines of `t1 t2 x y z roll pitch yaw`; z, roll and pitch are not used.

    Raises
    ------
    ArtifactError
        If the file is missing, empty, or a line has not eight numbers.
    """
    stamps: list[tuple[int, int]] = []
    rows: list[list[float]] = []
    try:
        text = read_text(path, MAX_TABLE_BYTES)
    except (OSError, ValueError) as err:
        msg = f"{path}: not a readable file of relations ({reason(err)})"
        raise ArtifactError(msg) from err
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            values = [float(word) for word in words[2:]]
            stamps.append((parse_stamp(words[0]), parse_stamp(words[1])))
        except (ValueError, IndexError):
            values = []
        # Python would take the one for a comma in a number, the other for digits.
        is_odd = "_" in line or not line.isascii()
        if is_odd or len(values) != 6 or not all(abs(value) <= _FARTHEST for value in values):
            msg = f"{path}:{number}: expected 't1 t2 x y z roll pitch yaw', found {line[:60]!r}"
            raise ArtifactError(msg)
        rows.append([values[0], values[1], values[5]])
    if not rows:
        msg = f"{path}: no relation in it, expected lines of 't1 t2 x y z roll pitch yaw'"
        raise ArtifactError(msg)
    table = np.array(stamps, dtype=np.int64)
    return Relations(table[:, 0], table[:, 1], np.array(rows))


def relation_errors(trajectory: Trajectory, relations: Relations) -> F64:
    """(n, 3) what must be added to each given pose to get the estimated one; NaN where a pose is missing."""
    known = known_poses(trajectory)
    first = nearest_stamp(known.stamps_ns, relations.first_ns)
    second = nearest_stamp(known.stamps_ns, relations.second_ns)
    errors = np.full((first.size, 3), np.nan)
    has_both = (first >= 0) & (second >= 0)
    estimated = between(known.poses[first[has_both]], known.poses[second[has_both]])
    errors[has_both] = between(relations.poses[has_both], estimated)
    return errors


def score_relations(name: str, trajectory: Trajectory, relations: Relations) -> Score:
    """Mean, standard deviation, median and maximum of the translation and of the rotation of the errors."""
    errors = relation_errors(trajectory, relations)
    used = np.isfinite(errors).all(axis=1)
    translation_m = np.hypot(errors[used, 0], errors[used, 1])
    rotation_deg = np.abs(np.degrees(errors[used, 2]))
    values = {"relations_used": float(used.sum()), "relations": float(used.size)}
    for kind, unit, numbers in (("translation", "m", translation_m), ("rotation", "deg", rotation_deg)):
        for word, function in (("mean", np.mean), ("std", np.std), ("median", np.median), ("max", np.max)):
            values[f"{kind}_{word}_{unit}"] = float(function(numbers)) if numbers.size else math.nan
    series = {"translation error, m": translation_m, "rotation error, deg": rotation_deg}
    return Score(name, float(used.mean()), values, series=series)


def published_line(score: Score) -> str:
    """One row in the form of the published tables: mean +- standard deviation."""
    v = score.values
    return (
        f"{score.name}: {v['translation_mean_m']:.4f} +- {v['translation_std_m']:.4f} m, "
        f"{v['rotation_mean_deg']:.3f} +- {v['rotation_std_deg']:.3f} deg, "
        f"{v['relations_used']:.0f} of {v['relations']:.0f} relations"
    )
