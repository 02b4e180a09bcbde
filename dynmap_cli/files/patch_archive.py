"""patches/patches.zip: manifest.json, one PGM and one .npy per patch, sequences.csv, and objects (`object_tables`).

The .npy holds the reflectance (float32, row 0 has the lowest y, NaN unknown); the PGM is a picture of it,
first row on top, 0 occupied, 205 unknown, 254 free. round_K.npy holds the means of the clusters with which up to
K states were tried, (clusters, rows, cols), 1 occupied, 0 free, NaN where nothing varies. sequences.csv has one row per
visit; why a visit has no patch stands in the manifest, under "unassigned". A sub-map whose states nobody saw has none.
"""

from __future__ import annotations

import csv
import io
import json
import math
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.arrays import F32
from dynmap_cli.domain.grid import FARTHEST_M, MAX_CELLS, GridFrame
from dynmap_cli.domain.patches import ChangingObject, Patch, PatchSet, Visit, cells_that_vary
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.domain.times import DAY_HOURS
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.atomic import replacing
from dynmap_cli.files.damage import DAMAGE, reason
from dynmap_cli.files.documents import MAX_TABLE_BYTES, parse_json
from dynmap_cli.files.manifest import FORMAT_VERSION
from dynmap_cli.files.npy import Column, parse_npy
from dynmap_cli.files.object_tables import (
    OBJECTS_TABLE,
    cells_bytes,
    entries_of,
    parse_objects,
    parse_table,
    table_bytes,
)
from dynmap_cli.files.pgm import pgm_bytes
from dynmap_cli.files.trajectory import format_stamp, parse_stamp

_COLUMNS = ("submap", "sequence", "log", "start_s", "end_s", "patch", "membership")
_DATE = (1980, 1, 1, 0, 0, 0)


def write_patches(
    path: Path, submaps: Sequence[SubMap], patch_sets: Iterable[PatchSet], visits: Sequence[Visit]
) -> None:
    """Write the archive; the same content gives the same bytes.

    Parameters
    ----------
    path : Path
    submaps : sequence of SubMap
    patch_sets : iterable of PatchSet
        Of those sub-maps whose states were seen.
    visits : sequence of Visit
        Of all sub-maps.
    """
    by_id = {patch_set.submap_id: patch_set for patch_set in patch_sets}
    content = {
        "format_version": FORMAT_VERSION,
        "resolution_m": submaps[0].frame.resolution_m if submaps else None,
        "submaps": [_entry(submap, by_id.get(submap.submap_id), visits) for submap in submaps],
    }
    with replacing(path) as part, zipfile.ZipFile(part, "w") as archive:
        _add(archive, "manifest.json", (json.dumps(content, indent=2) + "\n").encode())
        for number in sorted(by_id):
            for patch in by_id[number].patches:
                pgm, npy = _names(number, patch.patch_id)
                _add(archive, pgm, pgm_bytes(patch.cells))
                _add(archive, npy, _npy_bytes(patch.reflectance))
            if by_id[number].objects:
                _add(archive, _objects_name(number), cells_bytes(by_id[number].objects, by_id[number].frame))
            for name, means in zip(_round_names(by_id[number]), by_id[number].rounds, strict=True):
                _add(archive, name, _npy_bytes(means))
        _add(archive, "sequences.csv", _csv_bytes(visits))
        _add(archive, OBJECTS_TABLE, table_bytes(by_id[number] for number in sorted(by_id)))


def _entry(submap: SubMap, patch_set: PatchSet | None, visits: Sequence[Visit]) -> dict[str, Any]:
    """What the manifest says of a sub-map."""
    patches = patch_set.patches if patch_set else ()
    names = [_names(submap.submap_id, patch.patch_id) for patch in patches]
    frame = submap.frame
    return {
        "id": submap.submap_id,
        **({"name": submap.name} if submap.name else {}),
        "origin_m": [round(frame.origin_x_m, 9), round(frame.origin_y_m, 9)],
        "size_cells": [frame.cols, frame.rows],
        "area_m2": round(submap.area_m2, 9),
        "stay_probability": patch_set.stay_probability if patch_set else None,
        "bic": [round(value, 3) for value in patch_set.bic] if patch_set else [],
        "patches": [
            {
                "id": patch.patch_id,
                "support": patch.support,
                "pgm": pgm,
                "npy": npy,
                **({"share_by_hour": list(patch.share_by_hour)} if patch.share_by_hour else {}),
            }
            for patch, (pgm, npy) in zip(patches, names, strict=True)
        ],
        "rounds": _round_names(patch_set) if patch_set else [],
        "objects": entries_of(patch_set.objects, frame) if patch_set else [],
        "unassigned": {
            str(visit.sequence): visit.remark
            for visit in visits
            if visit.submap_id == submap.submap_id and visit.patch is None
        },
    }


def _names(submap_id: int, patch_id: int) -> tuple[str, str]:
    """Names of picture and values in the archive."""
    stem = f"submap_{submap_id:03d}/patch_{patch_id}"
    return f"{stem}.pgm", f"{stem}.npy"


def _objects_name(submap_id: int) -> str:
    """Name of the cells of the objects of a sub-map."""
    return f"submap_{submap_id:03d}/objects.npy"


def _round_names(patch_set: PatchSet) -> list[str]:
    """Names of the means of the clusters with which 1, 2, ... states were tried."""
    count = len(patch_set.rounds)
    return [f"submap_{patch_set.submap_id:03d}/round_{k}.npy" for k in range(1, count + 1)]


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    """Store a member with nothing of the machine or the hour in it."""
    info = zipfile.ZipInfo(name, _DATE)
    info.compress_type = zipfile.ZIP_DEFLATED
    info.create_system = 3
    info.external_attr = 0o644 << 16
    archive.writestr(info, content)


def _npy_bytes(values: F32) -> bytes:
    """Values of a patch or of clusters."""
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(values, dtype="<f4"), allow_pickle=False)
    return stream.getvalue()


def _csv_bytes(visits: Sequence[Visit]) -> bytes:
    """Table of the visits; patch and membership are empty where no state was recognised."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for visit in visits:
        writer.writerow(
            [
                visit.submap_id,
                visit.sequence,
                visit.recording,
                format_stamp(visit.start_ns),
                format_stamp(visit.end_ns),
                "" if visit.patch is None else visit.patch,
                "" if visit.patch is None else f"{visit.membership:.6f}",
            ]
        )
    return stream.getvalue().encode("utf-8", errors="backslashreplace")


def read_patches(path: Path) -> tuple[PatchSet, ...]:
    """Read the sub-maps whose states were learned.

    Raises
    ------
    ArtifactError
        If the archive is missing, damaged, absurdly large or of another format version.
    """
    with _Reader(path) as reader:
        content = reader.manifest()
        resolution = content["resolution_m"]
        entries = [entry for entry in content["submaps"] if entry["patches"]]
        _check_numbers(content["submaps"])
        states: dict[tuple[int, int], dict[int, str]] = {}
        if any(entry.get("objects") for entry in entries):
            states = parse_table(reader.member(OBJECTS_TABLE, MAX_TABLE_BYTES))
        return tuple(_patch_set(reader, entry, resolution, states) for entry in entries)


def read_visits(path: Path) -> tuple[Visit, ...]:
    """Read the visits of all sub-maps, as `write_patches` was given them."""
    with _Reader(path) as reader:
        content = reader.manifest()
        remarks = {
            (int(entry["id"]), int(sequence)): str(remark)
            for entry in content["submaps"]
            for sequence, remark in entry.get("unassigned", {}).items()
        }
        rows = csv.DictReader(io.StringIO(reader.member("sequences.csv", MAX_TABLE_BYTES).decode("utf-8")))
        visits = tuple(_visit(row, remarks) for row in rows)
        _check_visits(content["submaps"], visits)
        return visits


def read_names(path: Path) -> dict[int, str]:
    """Read what people call each sub-map, "" where nobody gave it a name, by its number."""
    with _Reader(path) as reader:
        return {int(entry["id"]): str(entry.get("name", "")) for entry in reader.manifest()["submaps"]}


def read_rounds(path: Path) -> dict[int, tuple[F32, ...]]:
    """Read the means of the clusters of each round, (k, rows, cols), by sub-map; k is at most the round's number."""
    with _Reader(path) as reader:
        found = {}
        for entry in reader.manifest()["submaps"]:
            cols, rows = (int(size) for size in entry["size_cells"])
            names = [str(name) for name in entry.get("rounds", ())]
            too_large = min(cols, rows) < 1 or cols * rows * len(names) ** 2 > 2 * MAX_CELLS
            if too_large or (names and len(names) != len(entry["bic"])):
                msg = f"sub-map {entry['id']} of {cols} x {rows} cells with {len(names)} rounds"
                raise ValueError(msg)
            found[int(entry["id"])] = tuple(
                reader.values(name, (None, rows, cols), k * rows * cols)
                for k, name in enumerate(names, start=1)
            )
        return found


def _visit(row: dict[str, str], remarks: dict[tuple[int, int], str]) -> Visit:
    """One row of sequences.csv."""
    submap_id, sequence = int(row["submap"]), int(row["sequence"])
    return Visit(
        submap_id=submap_id,
        sequence=sequence,
        recording=row["log"],
        start_ns=parse_stamp(row["start_s"]),
        end_ns=parse_stamp(row["end_s"]),
        patch=int(row["patch"]) if row["patch"] else None,
        membership=float(row["membership"]) if row["patch"] else math.nan,
        remark=remarks.get((submap_id, sequence), ""),
    )


def _check_numbers(entries: Sequence[dict[str, Any]]) -> None:
    """Refuse a manifest in which a sub-map, or a patch of one, stands twice."""
    for what, numbers in (
        ("sub-map", [int(entry["id"]) for entry in entries]),
        *(
            (f"patch of sub-map {entry['id']}", [int(patch["id"]) for patch in entry["patches"]])
            for entry in entries
        ),
    ):
        if len(set(numbers)) < len(numbers) or min(numbers, default=0) < 0:
            msg = f"the numbers {numbers} of each {what} in manifest.json: some stand twice or are negative"
            raise ValueError(msg)


def _check_visits(entries: Sequence[dict[str, Any]], visits: Sequence[Visit]) -> None:
    """Refuse visits of patches that there are none of."""
    known = {(int(entry["id"]), int(patch["id"])) for entry in entries for patch in entry["patches"]}
    for visit in visits:
        if visit.patch is not None and (visit.submap_id, visit.patch) not in known:
            msg = f"sequences.csv: patch {visit.patch} of sub-map {visit.submap_id} was visited, manifest.json has none"
            raise ValueError(msg)


def _patch_set(
    reader: _Reader,
    entry: dict[str, Any],
    resolution_m: float,
    object_states: Mapping[tuple[int, int], Mapping[int, str]],
) -> PatchSet:
    """One sub-map of the manifest with its patches."""
    cols, rows = (int(size) for size in entry["size_cells"])
    stay, resolution = float(entry["stay_probability"]), float(resolution_m)
    if min(cols, rows) < 1 or cols * rows > MAX_CELLS:
        msg = f"sub-map {entry['id']} of {cols} x {rows} cells"
        raise ValueError(msg)
    if not (0.0 <= stay <= 1.0 and 0.0 < resolution < math.inf):
        msg = f"stay_probability {stay}, resolution_m {resolution}"
        raise ValueError(msg)
    origin_x, origin_y = (float(value) for value in entry["origin_m"])
    if not (abs(origin_x) <= FARTHEST_M and abs(origin_y) <= FARTHEST_M):
        msg = f"origin_m {entry['origin_m']}"
        raise ValueError(msg)
    patches = tuple(
        Patch(
            int(patch["id"]),
            int(patch["support"]),
            reader.values(str(patch["npy"]), (rows, cols), rows * cols),
            _shares(patch.get("share_by_hour", ())),
        )
        for patch in entry["patches"]
    )
    frame = GridFrame(resolution, origin_x, origin_y, rows, cols)
    bic = tuple(float(value) for value in entry.get("bic", ()))
    if not all(map(math.isfinite, bic)):
        msg = f"bic {bic}"
        raise ValueError(msg)
    number = int(entry["id"])
    objects: tuple[ChangingObject, ...] = ()
    if entry.get("objects"):
        cells = reader.member(_objects_name(number), 2 * rows * cols + 4096)
        states = {thing: seen for (submap_id, thing), seen in object_states.items() if submap_id == number}
        objects = parse_objects(entry["objects"], cells, frame, states)
    return PatchSet(number, frame, cells_that_vary(patches), patches, stay, bic, objects=objects)


def _shares(values: Sequence[Any]) -> tuple[float, ...]:
    """Probability of a patch by hour of the day; 24 numbers or none."""
    shares = tuple(float(value) for value in values)
    if len(shares) not in (0, DAY_HOURS) or not all(0.0 <= share <= 1.0 for share in shares):
        msg = f"share_by_hour {shares}"
        raise ValueError(msg)
    return shares


class _Reader:
    """An open archive; whatever is wrong with it becomes one line."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> _Reader:
        try:
            self._archive = zipfile.ZipFile(self._path)
        except DAMAGE as err:
            msg = (
                f"{self._path}: not a readable patch archive ({reason(err)}). "
                "Run `dynmap cluster` again with --force."
            )
            raise ArtifactError(msg) from err
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._archive.close()
        if isinstance(error, DAMAGE):
            msg = f"{self._path}: damaged patch archive ({reason(error)}). Run `dynmap cluster` again with --force."
            raise ArtifactError(msg) from error

    def member(self, name: str, max_bytes: int) -> bytes:
        """Content of a member, read in memory and nowhere else, so that its name cannot lead out of the archive."""
        info = self._archive.getinfo(name)
        if info.file_size > max_bytes:
            msg = f"{name} unpacks to {info.file_size} bytes, at most {max_bytes} are allowed"
            raise ValueError(msg)
        with self._archive.open(info) as stream:
            return stream.read(max_bytes)

    def manifest(self) -> dict[str, Any]:
        """The manifest, of this format version."""
        content = parse_json(self.member("manifest.json", MAX_TABLE_BYTES).decode("utf-8"))
        found = content.get("format_version")
        if found != FORMAT_VERSION:
            msg = (
                f"{self._path}: written in format version {found}, this dynmap reads version {FORMAT_VERSION}. "
                "Run `dynmap cluster` again with --force, or use the dynmap that wrote it."
            )
            raise ArtifactError(msg)
        return dict(content)

    def values(self, name: str, shape: tuple[int | None, ...], most: int) -> F32:
        """Values of a patch or of clusters, at most so many, in [0, 1] or NaN."""
        content = self.member(name, 4 * most + 4096)
        values: F32 = parse_npy(io.BytesIO(content), len(content), Column("<f4", shape), name)
        if values.size > most:
            msg = f"{name} has shape {values.shape}"
            raise ValueError(msg)
        if not bool((np.isnan(values) | ((values >= 0.0) & (values <= 1.0))).all()):
            msg = f"{name} has values outside 0 to 1"
            raise ValueError(msg)
        return values
