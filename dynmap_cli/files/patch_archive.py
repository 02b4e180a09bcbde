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
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.arrays import F32
from dynmap_cli.domain.patches import ChangingObject, Patch, PatchSet, Visit, cells_that_vary
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.errors import ArtifactError
from dynmap_cli.files.atomic import replacing
from dynmap_cli.files.csv_tables import rows_of, whole_in
from dynmap_cli.files.damage import DAMAGE, reason
from dynmap_cli.files.documents import MAX_TABLE_BYTES, as_text, parse_json
from dynmap_cli.files.manifest import FORMAT_VERSION
from dynmap_cli.files.npy import Column, parse_npy
from dynmap_cli.files.object_tables import (
    OBJECTS_TABLE,
    cells_bytes,
    check_table,
    entries_of,
    parse_objects,
    parse_table,
    table_bytes,
)
from dynmap_cli.files.patch_manifest import MANIFEST, SubMapEntry, check_supports, parse_entries
from dynmap_cli.files.pgm import pgm_bytes
from dynmap_cli.files.plain_values import mapping_at, number_in, said, text_at
from dynmap_cli.files.trajectory import format_stamp, parse_stamp
from dynmap_cli.files.zip_archive import ZipArchive
from dynmap_cli.printable import printable

_COLUMNS = ("submap", "sequence", "log", "start_s", "end_s", "patch", "membership")
_VISITS = "sequences.csv"
_UNREADABLE, _DAMAGED = "not a readable patch archive", "damaged patch archive"
_REMEDY = "Run `dynmap cluster` again with --force."
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
        _add(archive, MANIFEST, (json.dumps(content, indent=2) + "\n").encode())
        for number in sorted(by_id):
            for patch in by_id[number].patches:
                pgm, npy = _names(number, patch.patch_id)
                _add(archive, pgm, pgm_bytes(patch.cells))
                _add(archive, npy, _npy_bytes(patch.reflectance))
            if by_id[number].objects:
                _add(archive, _objects_name(number), cells_bytes(by_id[number].objects, by_id[number].frame))
            for name, means in zip(_round_names(by_id[number]), by_id[number].rounds, strict=True):
                _add(archive, name, _npy_bytes(means))
        _add(archive, _VISITS, _csv_bytes(visits))
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
                printable(visit.recording),
                format_stamp(visit.start_ns),
                format_stamp(visit.end_ns),
                "" if visit.patch is None else visit.patch,
                "" if visit.patch is None else f"{visit.membership:.6f}",
            ]
        )
    return stream.getvalue().encode("utf-8")


def read_patches(path: Path, remedy: str = _REMEDY) -> tuple[PatchSet, ...]:
    """Read the sub-maps whose states were learned; *remedy* is what a message advises.

    Raises
    ------
    ArtifactError
        If the archive is missing, damaged, absurdly large or of another format version.
    """
    with _Reader(path, remedy) as reader:
        entries = reader.entries()
        visits = reader.visits(entries)
        with_patches = [entry for entry in entries if entry.patches]
        states: dict[tuple[int, int], dict[int, str]] = {}
        if any(entry.objects for entry in with_patches):
            states = parse_table(reader.member(OBJECTS_TABLE))
            check_table(
                states,
                {(entry.submap_id, number) for entry in with_patches for number, _ in entry.objects},
                {(visit.submap_id, visit.sequence) for visit in visits},
            )
        return tuple(_patch_set(reader, entry, states) for entry in with_patches)


def read_visits(path: Path) -> tuple[Visit, ...]:
    """Read the visits of all sub-maps, as `write_patches` was given them."""
    with _Reader(path) as reader:
        return reader.visits(reader.entries())


def read_names(path: Path) -> dict[int, str]:
    """Read what people call each sub-map, "" where nobody gave it a name, by its number."""
    with _Reader(path) as reader:
        return {entry.submap_id: entry.name for entry in reader.entries()}


def read_rounds(path: Path) -> dict[int, tuple[F32, ...]]:
    """Read the means of the clusters of each round, (k, rows, cols), by sub-map; k is at most the round's number."""
    with _Reader(path) as reader:
        return {
            entry.submap_id: tuple(
                reader.values(name, (None, *entry.frame.shape), k * entry.frame.rows * entry.frame.cols)
                for k, name in enumerate(entry.rounds, start=1)
            )
            for entry in reader.entries()
        }


def _patch_set(
    reader: _Reader, entry: SubMapEntry, object_states: Mapping[tuple[int, int], Mapping[int, str]]
) -> PatchSet:
    """One sub-map of the manifest with its patches."""
    rows, cols = entry.frame.shape
    patches = tuple(
        Patch(
            patch.patch_id,
            patch.support,
            reader.values(patch.npy, (rows, cols), rows * cols),
            patch.share_by_hour,
        )
        for patch in entry.patches
    )
    objects: tuple[ChangingObject, ...] = ()
    if entry.objects:
        name = _objects_name(entry.submap_id)
        states = {
            thing: seen for (submap_id, thing), seen in object_states.items() if submap_id == entry.submap_id
        }
        cells = reader.member(name, 2 * rows * cols + 4096)
        objects = parse_objects(entry.objects, cells, name, entry.frame, states)
    return PatchSet(
        entry.submap_id,
        entry.frame,
        cells_that_vary(patches),
        patches,
        entry.stay_probability if entry.stay_probability is not None else math.nan,
        entry.bic,
        objects=objects,
    )


def _visits_of(content: bytes, entries: Sequence[SubMapEntry]) -> tuple[Visit, ...]:
    """Rows of sequences.csv, as the manifest allows them; raises ValueError."""
    remarks = {entry.submap_id: entry.unassigned for entry in entries}
    visits: dict[tuple[int, int], Visit] = {}
    for where, row in rows_of(content, _COLUMNS, _VISITS):
        visit = _visit(where, row, remarks)
        number = (visit.submap_id, visit.sequence)
        if number in visits:
            msg = f"{where}: visit {visit.sequence} of sub-map {visit.submap_id} is there twice"
            raise ValueError(msg)
        visits[number] = visit
    seen = Counter((visit.submap_id, visit.patch) for visit in visits.values() if visit.patch is not None)
    check_supports(entries, dict(seen))
    return tuple(visits.values())


def _visit(where: str, row: Mapping[str, str], remarks: Mapping[int, Mapping[int, str]]) -> Visit:
    """One row of sequences.csv."""
    submap_id = whole_in(row["submap"], f"{where}: submap")
    sequence = whole_in(row["sequence"], f"{where}: sequence")
    if submap_id not in remarks:
        msg = f"{where}: sub-map {submap_id} is not in {MANIFEST}"
        raise ValueError(msg)
    is_assigned = row["patch"] != ""
    remark = remarks[submap_id].get(sequence)
    if is_assigned == (remark is not None) or is_assigned != (row["membership"] != ""):
        msg = f"{where}: a visit has a patch and a membership, or a remark under unassigned in {MANIFEST}"
        raise ValueError(msg)
    start_ns, end_ns = (_stamp(row[name], f"{where}: {name}") for name in ("start_s", "end_s"))
    if start_ns > end_ns:
        msg = f"{where}: start_s {row['start_s']} is after end_s {row['end_s']}"
        raise ValueError(msg)
    return Visit(
        submap_id=submap_id,
        sequence=sequence,
        recording=text_at(row["log"], f"{where}: log"),
        start_ns=start_ns,
        end_ns=end_ns,
        patch=whole_in(row["patch"], f"{where}: patch") if is_assigned else None,
        membership=_membership(row["membership"], where) if is_assigned else math.nan,
        remark=remark or "",
    )


def _stamp(word: str, where: str) -> int:
    """A time of a visit."""
    try:
        return parse_stamp(word)
    except (ValueError, OverflowError) as err:
        msg = f"{where} is {said(word)}, not seconds"
        raise ValueError(msg) from err


def _membership(word: str, where: str) -> float:
    """How well a visit fits its patch."""
    try:
        value = number_in(word)
    except ValueError:
        value = math.nan
    if not 0.0 <= value <= 1.0:
        msg = f"{where}: membership is {said(word)}, not a number from 0 to 1"
        raise ValueError(msg)
    return value


class _Reader:
    """An open archive; whatever is wrong with it becomes one line."""

    def __init__(self, path: Path, remedy: str = _REMEDY) -> None:
        self._path = path
        self._remedy = remedy

    def __enter__(self) -> _Reader:
        try:
            self._archive = ZipArchive(self._path)
        except DAMAGE as err:
            raise self._refused(_UNREADABLE, err) from err
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._archive.close()
        if isinstance(error, DAMAGE):
            raise self._refused(_DAMAGED, error) from error

    def _refused(self, what: str, error: BaseException) -> ArtifactError:
        return ArtifactError(f"{self._path}: {what} ({reason(error)}). {self._remedy}")

    def member(self, name: str, max_bytes: int = MAX_TABLE_BYTES) -> bytes:
        """Content of a member."""
        return self._archive.member(name, max_bytes)

    def entries(self) -> tuple[SubMapEntry, ...]:
        """The sub-maps of the manifest, which must be of this format version."""
        try:
            content = mapping_at(parse_json(as_text(self.member(MANIFEST), "it")), "it")
        except ValueError as err:
            msg = f"{MANIFEST}: {err}"
            raise ValueError(msg) from err
        found = content.get("format_version")
        if found != FORMAT_VERSION:
            msg = (
                f"{self._path}: written in format version {said(found)}, this dynmap reads version "
                f"{FORMAT_VERSION}. Run `dynmap cluster` again with --force, or use the dynmap that wrote it."
            )
            raise ArtifactError(msg)
        return parse_entries(content)

    def visits(self, entries: Sequence[SubMapEntry]) -> tuple[Visit, ...]:
        """The visits of all sub-maps, as many of each patch as the manifest says."""
        return _visits_of(self.member(_VISITS), entries)

    def values(self, name: str, shape: tuple[int | None, ...], most: int) -> F32:
        """Values of a patch or of clusters, at most so many, in [0, 1] or NaN."""
        content = self.member(name, 4 * most + 4096)
        values: F32 = parse_npy(io.BytesIO(content), len(content), Column("<f4", shape), name)
        if values.size > most:
            msg = f"{name} has {values.size} values, at most {most} are allowed"
            raise ValueError(msg)
        is_right = np.isnan(values) | ((values >= 0.0) & (values <= 1.0))
        if not bool(is_right.all()):
            msg = f"{name} holds {values[~is_right][0]:g}, values are from 0 to 1, or NaN where nothing is known"
            raise ValueError(msg)
        return values
