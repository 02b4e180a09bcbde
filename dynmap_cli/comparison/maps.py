"""The maps of a run that are compared: the patch map, and what one would have without it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dynmap_cli.domain.grid import OccupancyGrid
from dynmap_cli.domain.patches import Patch, PatchSet, Visit
from dynmap_cli.files.patch_archive import read_patches, read_visits
from dynmap_cli.files.pgm import read_map

PATCH_MAP = "patch map"


@dataclass(frozen=True, slots=True)
class ComparedMap:
    """A map to localize in.

    Attributes
    ----------
    name : str
    about : str
        What it shows.
    grid : OccupancyGrid
    patch_sets : tuple of PatchSet
    visits : tuple of Visit
        From which the states of the patch sets were learned; none where these are fixed.
    """

    name: str
    about: str
    grid: OccupancyGrid
    patch_sets: tuple[PatchSet, ...]
    visits: tuple[Visit, ...] = ()


def compared_maps(run_dir: Path, most_states: int) -> tuple[list[ComparedMap], int]:
    """The maps, the patch map first, and how many maps of one state were left out.

    A map of state k has every sub-map in the state that `states.csv` calls k, or in its most common one where it has no
    such state.
    """
    filtered, _ = read_map(run_dir / "map" / "map.yaml")
    unfiltered, _ = read_map(run_dir / "map" / "unfiltered.yaml")
    archive = run_dir / "patches" / "patches.zip"
    sets = tuple(one for one in read_patches(archive) if one.patches)
    maps = [
        ComparedMap(
            PATCH_MAP, "every sub-map in the state that is believed", filtered, sets, read_visits(archive)
        ),
        ComparedMap("all beams", "the map that all beams draw, without filter", unfiltered, ()),
        ComparedMap("filtered map", "the map without what moves", filtered, ()),
    ]
    if sets:
        about = "occupied where any state is"
        maps.append(ComparedMap("all states", about, filtered, tuple(map(union_of_states, sets))))
    numbers = state_numbers(sets)
    maps += [
        ComparedMap(
            f"state {number}",
            f"every sub-map in state {number}, or in its most common",
            filtered,
            tuple(one_state(one, number) for one in sets),
        )
        for number in sorted(numbers[:most_states])
    ]
    return maps, len(numbers[most_states:])


def state_numbers(patch_sets: Sequence[PatchSet]) -> list[int]:
    """Numbers of the states of all sub-maps together, those that were seen most often first."""
    seen: Counter[int] = Counter()
    for patch_set in patch_sets:
        for patch in patch_set.patches:
            seen[patch.patch_id] += patch.support
    return sorted(seen, key=lambda number: (-seen[number], number))


def union_of_states(patch_set: PatchSet) -> PatchSet:
    """The same sub-map with one state, in which a cell reflects as in the state in which it reflects most."""
    values = np.stack([patch.reflectance for patch in patch_set.patches])
    most = np.where(np.isnan(values), np.float32(-1.0), values).max(axis=0)
    most[most < 0.0] = np.nan
    return _with(patch_set, [Patch(0, sum(patch.support for patch in patch_set.patches), most)])


def one_state(patch_set: PatchSet, number: int) -> PatchSet:
    """The same sub-map with the state of this number alone, or with its most common one."""
    order = sorted(
        patch_set.patches, key=lambda patch: (patch.patch_id != number, -patch.support, patch.patch_id)
    )
    return _with(patch_set, order[:1])


def _with(patch_set: PatchSet, patches: Sequence[Patch]) -> PatchSet:
    return replace(patch_set, patches=tuple(patches), objects=())
