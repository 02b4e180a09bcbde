"""What `dynmap simulate` writes beside a recording, and the run that is measured against it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynmap_cli.arrays import B1, F32, F64, I32, I64
from dynmap_cli.domain.poses import Trajectory
from dynmap_cli.domain.scans import ScanLog
from dynmap_cli.errors import ArtifactError
from dynmap_cli.evaluation.association import known_poses, nearest_stamp
from dynmap_cli.evaluation.trajectories import align
from dynmap_cli.files.counting_map import read_beams, read_unknown
from dynmap_cli.files.damage import refusing_damage
from dynmap_cli.files.documents import MAX_TABLE_BYTES, parse_json, read_text
from dynmap_cli.files.manifest import read_manifest
from dynmap_cli.files.npy import Column, read_npz
from dynmap_cli.files.registered import read_registered
from dynmap_cli.files.trajectory import read_tum

_SAME_SCAN_S = 0.001
_LEAST_POSES = 10
_MOST_BYTES = 4 * 2**30


@dataclass(frozen=True, slots=True)
class TrueObject:
    """A door or box that changes.

    Attributes
    ----------
    name : str
    beam_class : int
        Class of the beams that end on it.
    states : tuple of str
    """

    name: str
    beam_class: int
    states: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Truth:
    """What was really there.

    Attributes
    ----------
    trajectory : Trajectory
    beam_class : (n_scans, n_beams) int32
    object_states : (n_scans, n_objects) int32
    objects : tuple of TrueObject
    static, moving, no_return, mixed, first_object : int
        Codes of the classes; first_object + k is object k.
    """

    trajectory: Trajectory
    beam_class: I32
    object_states: I32
    objects: tuple[TrueObject, ...]
    static: int
    moving: int
    no_return: int
    mixed: int
    first_object: int


@dataclass(frozen=True, slots=True)
class Run:
    """A finished run directory, as far as it is measured.

    Attributes
    ----------
    folder : Path
    log : ScanLog
    poses : (n_scans, 3) float64
    static_probability : (n_scans, n_beams) float32
    is_unknown : (n_scans, n_beams) bool
    settings : dict
        Of the stage `map`.
    """

    folder: Path
    log: ScanLog
    poses: F64
    static_probability: F32
    is_unknown: B1
    settings: dict[str, float]


def read_truth(folder: Path) -> Truth:
    """Read `<LOG>.truth/`.

    Raises
    ------
    ArtifactError
        If a file is missing or damaged.
    """
    trajectory = read_tum(folder / "trajectory.tum")
    with refusing_damage(
        f"{folder}: not the truth of a simulated recording",
        "Expected what `dynmap simulate` writes.",
        ArtifactError,
    ):
        content = parse_json(read_text(folder / "truth.json", MAX_TABLE_BYTES))
        objects = tuple(
            TrueObject(str(entry["name"]), int(entry["class"]), tuple(map(str, entry["states"])))
            for entry in content["objects"]
        )
        n_scans = trajectory.stamps_ns.size
        arrays = read_npz(
            folder / "beams.npz",
            {
                "beam_class": Column("<i2", (n_scans, None)),
                "object_states": Column("<i4", (n_scans, len(objects))),
            },
            max_bytes=_MOST_BYTES,
        )
        codes = {name: int(content["classes"][name]) for name in _CODES}
        beam_class, object_states = arrays["beam_class"].astype(np.int32), arrays["object_states"]
        counts = np.array([len(thing.states) for thing in objects], dtype=np.int64)
        if ((object_states < 0) | (object_states >= counts)).any():
            msg = "object_states points outside the states of an object"
            raise ValueError(msg)
    return Truth(trajectory, beam_class, object_states, objects, **codes)


_CODES = ("static", "moving", "no_return", "mixed", "first_object")


def read_run(folder: Path) -> Run:
    """Read scans, poses and beams of a run whose stage `map` is done."""
    manifest = read_manifest(folder / "map", "map")
    if manifest is None:
        msg = f"{folder}: not a run directory with a finished map. Run `dynmap build` first."
        raise ArtifactError(msg)
    log, trajectory = read_registered(folder / "scans", folder / "map")
    path, shape = folder / "map" / "beams.npz", (log.n_scans, log.n_beams)
    e, is_unknown = read_beams(path, shape), read_unknown(path, shape)
    return Run(folder, log, trajectory.poses, e, is_unknown, manifest.settings)


def same_scans(stamps_ns: I64, truth: Truth) -> tuple[I64, I64]:
    """Indices (in the run, in the truth) of the scans that are in both; of equal stamps the k-th meets the k-th."""
    found = nearest_stamp(truth.trajectory.stamps_ns, stamps_ns, _SAME_SCAN_S)
    mine = np.flatnonzero(found >= 0)
    first = np.searchsorted(stamps_ns, stamps_ns[mine])
    theirs = np.searchsorted(truth.trajectory.stamps_ns, truth.trajectory.stamps_ns[found[mine]])
    theirs = theirs + (mine - first)
    is_there = theirs < truth.trajectory.stamps_ns.size
    return mine[is_there], theirs[is_there]


def truth_from_map(map_trajectory: Trajectory, truth: Truth) -> F64:
    """Pose truth_from_map: how the frame of a run's map lies in the frame of the truth.

    Raises
    ------
    ArtifactError
        If the two have no times in common.
    """
    known = known_poses(map_trajectory)
    mine, theirs = same_scans(known.stamps_ns, truth)
    if mine.size < _LEAST_POSES:
        msg = (
            f"{mine.size} poses have a time in common with the truth, at least {_LEAST_POSES} are needed. "
            "Is it the truth of this recording?"
        )
        raise ArtifactError(msg)
    return align(known.poses[mine, :2], truth.trajectory.poses[theirs, :2])
