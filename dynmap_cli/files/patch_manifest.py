"""manifest.json of patches.zip: what it may say, or a `ValueError` that says where it says something else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from dynmap_cli.domain.grid import FARTHEST_M, MAX_CELLS, RESOLUTIONS_M, GridFrame
from dynmap_cli.domain.times import DAY_HOURS
from dynmap_cli.files.edits import name_at
from dynmap_cli.files.plain_values import (
    distinct,
    item_of,
    list_at,
    mapping_at,
    number_at,
    numbers_at,
    said,
    text_at,
    whole_at,
)

MANIFEST = "manifest.json"
_MOST_ID, _MOST_VISITS = 2**31 - 1, 2**31 - 1
_MOST_VALUES = 2 * MAX_CELLS
_SHARES_DIFFER = 0.001
"""They are written with six decimals."""


@dataclass(frozen=True, slots=True)
class PatchEntry:
    """What is said of a patch: its number, how many visits saw it, the member with its values, shares by hour."""

    patch_id: int
    support: int
    npy: str
    share_by_hour: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class SubMapEntry:
    """What is said of a sub-map.

    Attributes
    ----------
    where : str
        Where it stands in the manifest.
    submap_id : int
    name : str
        "" where nobody gave it one.
    frame : GridFrame
    stay_probability : float or None
        None where no state was seen.
    bic : tuple of float
    patches : tuple of PatchEntry
    rounds : tuple of str
        Members with the means of clusters.
    objects : tuple of (int, int)
        Number and count of cells.
    unassigned : dict of int to str
        Why a visit has no patch, by its number.
    """

    where: str
    submap_id: int
    name: str
    frame: GridFrame
    stay_probability: float | None
    bic: tuple[float, ...]
    patches: tuple[PatchEntry, ...]
    rounds: tuple[str, ...]
    objects: tuple[tuple[int, int], ...]
    unassigned: dict[int, str]


def parse_entries(content: dict[str, Any]) -> tuple[SubMapEntry, ...]:
    """All sub-maps of the manifest; raises ValueError."""
    listed = list_at(item_of(content, "submaps", MANIFEST), f"{MANIFEST}: submaps")
    if not listed:
        return ()
    resolution = number_at(
        item_of(content, "resolution_m", MANIFEST), f"{MANIFEST}: resolution_m", *RESOLUTIONS_M
    )
    entries = tuple(_submap(entry, f"{MANIFEST}: submaps[{k}]", resolution) for k, entry in enumerate(listed))
    distinct([entry.submap_id for entry in entries], f"{MANIFEST}: sub-map")
    members = [patch.npy for entry in entries for patch in entry.patches]
    members += [name for entry in entries for name in entry.rounds]
    if len(set(members)) < len(members):
        msg = f"{MANIFEST}: one .npy is named for two patches or rounds"
        raise ValueError(msg)
    values = sum(entry.frame.rows * entry.frame.cols * len(entry.patches) for entry in entries)
    if values > _MOST_VALUES:
        msg = f"{MANIFEST}: patches of {values} cells, at most {_MOST_VALUES} are allowed"
        raise ValueError(msg)
    return entries


def _submap(value: object, where: str, resolution_m: float) -> SubMapEntry:
    """One entry of `submaps`."""
    entry = mapping_at(value, where)
    patches = tuple(
        _patch(one, f"{where}.patches[{k}]")
        for k, one in enumerate(list_at(item_of(entry, "patches", where), f"{where}.patches"))
    )
    distinct([patch.patch_id for patch in patches], f"{where}: patch")
    _check_shares(patches, where)
    stay = item_of(entry, "stay_probability", where)
    if patches or stay is not None:
        stay = number_at(stay, f"{where}.stay_probability", 0.0, 1.0)
    bic = numbers_at(entry.get("bic", []), f"{where}.bic")
    rounds = tuple(
        text_at(one, f"{where}.rounds[{k}]")
        for k, one in enumerate(list_at(entry.get("rounds", []), f"{where}.rounds"))
    )
    frame = _frame(entry, where, resolution_m)
    if rounds and bic and len(rounds) != len(bic):
        msg = f"{where} has {len(rounds)} rounds, but bic of {len(bic)}"
        raise ValueError(msg)
    if frame.rows * frame.cols * len(rounds) ** 2 > _MOST_VALUES:
        msg = f"{where} has {len(rounds)} rounds of {frame.cols} x {frame.rows} cells, more than are allowed"
        raise ValueError(msg)
    return SubMapEntry(
        where=where,
        submap_id=whole_at(item_of(entry, "id", where), f"{where}.id", 0, _MOST_ID),
        name=name_at(entry["name"], f"{where}.name") if "name" in entry else "",
        frame=frame,
        stay_probability=stay,
        bic=bic,
        patches=patches,
        rounds=rounds,
        objects=_objects(entry.get("objects", []), where),
        unassigned=_unassigned(entry.get("unassigned", {}), f"{where}.unassigned"),
    )


def _frame(entry: dict[str, Any], where: str, resolution_m: float) -> GridFrame:
    """Rectangle of a sub-map."""
    sizes = list_at(item_of(entry, "size_cells", where), f"{where}.size_cells")
    if len(sizes) != 2:
        msg = f"{where}.size_cells is {said(sizes)}, not [columns, rows]"
        raise ValueError(msg)
    cols, rows = (whole_at(size, f"{where}.size_cells[{k}]", 1, MAX_CELLS) for k, size in enumerate(sizes))
    if cols * rows > MAX_CELLS:
        msg = f"{where}.size_cells is {said(sizes)}, more than {MAX_CELLS} cells"
        raise ValueError(msg)
    origin = numbers_at(item_of(entry, "origin_m", where), f"{where}.origin_m", -FARTHEST_M, FARTHEST_M)
    if len(origin) != 2:
        msg = f"{where}.origin_m is {said(origin)}, not [x, y]"
        raise ValueError(msg)
    return GridFrame(resolution_m, origin[0], origin[1], rows, cols)


def _patch(value: object, where: str) -> PatchEntry:
    """One entry of `patches`."""
    entry = mapping_at(value, where)
    shares = numbers_at(entry.get("share_by_hour", []), f"{where}.share_by_hour", 0.0, 1.0)
    if len(shares) not in (0, DAY_HOURS):
        msg = f"{where}.share_by_hour has {len(shares)} values, not {DAY_HOURS}"
        raise ValueError(msg)
    return PatchEntry(
        whole_at(item_of(entry, "id", where), f"{where}.id", 0, _MOST_ID),
        whole_at(item_of(entry, "support", where), f"{where}.support", 0, _MOST_VISITS),
        text_at(item_of(entry, "npy", where), f"{where}.npy"),
        shares,
    )


def _check_shares(patches: Sequence[PatchEntry], where: str) -> None:
    """Refuse shares that only some patches have, or that are not those of all states together."""
    shares = [patch.share_by_hour for patch in patches]
    if len({len(one) for one in shares}) > 1:
        msg = f"{where}: some patches have share_by_hour and some have not"
        raise ValueError(msg)
    for hour, of_patches in enumerate(zip(*shares, strict=True)):
        if abs(sum(of_patches) - 1.0) > _SHARES_DIFFER:
            msg = f"{where}: share_by_hour of hour {hour} adds up to {sum(of_patches):.6g}, not 1"
            raise ValueError(msg)


def _objects(value: object, where: str) -> tuple[tuple[int, int], ...]:
    """Number and count of cells of each entry of `objects`."""
    found = []
    for k, one in enumerate(list_at(value, f"{where}.objects")):
        at = f"{where}.objects[{k}]"
        entry = mapping_at(one, at)
        number = whole_at(item_of(entry, "id", at), f"{at}.id", 0, 2**15 - 1)
        found.append((number, whole_at(item_of(entry, "cells", at), f"{at}.cells", 1, MAX_CELLS)))
    distinct([number for number, _ in found], f"{where}: object")
    return tuple(found)


def _unassigned(value: object, where: str) -> dict[int, str]:
    """Remarks by the number of the visit."""
    found = {}
    for key, remark in mapping_at(value, where).items():
        if not (key.isascii() and key.isdecimal() and len(key) <= 10):
            msg = f"{where} is about {said(key)}, not the number of a visit"
            raise ValueError(msg)
        found[int(key)] = text_at(remark, f"{where}.{key}")
    return found


def check_supports(entries: Sequence[SubMapEntry], seen: dict[tuple[int, int], int]) -> None:
    """Refuse patches that more or fewer visits saw than it is said; *seen* counts them by sub-map and patch."""
    known = {(entry.submap_id, patch.patch_id) for entry in entries for patch in entry.patches}
    for submap_id, patch_id in sorted(set(seen) - known):
        msg = f"sequences.csv: patch {patch_id} of sub-map {submap_id} was visited, {MANIFEST} has none"
        raise ValueError(msg)
    for entry in entries:
        for k, patch in enumerate(entry.patches):
            visits = seen.get((entry.submap_id, patch.patch_id), 0)
            if patch.support != visits:
                msg = (
                    f"{entry.where}.patches[{k}].support is {patch.support}, "
                    f"but {visits} visits of sequences.csv saw patch {patch.patch_id}"
                )
                raise ValueError(msg)
