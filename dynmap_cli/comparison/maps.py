"""The maps of a run that are compared: the patch map, and what one would have without it."""

from __future__ import annotations

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

    A map of one state has every sub-map in its k-th most common state (in its rarest, where it has fewer), so there
    are as many as the richest sub-map has states.
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
    richest = max((len(one.patches) for one in sets), default=0)
    if richest:
        about = "occupied where any state is"
        maps.append(ComparedMap("all states", about, filtered, tuple(map(union_of_states, sets))))
    shown = min(richest, most_states)
    maps += [
        ComparedMap(
            f"state {rank + 1}",
            f"every sub-map in its {_ordinal(rank + 1)} state",
            filtered,
            tuple(one_state(one, rank) for one in sets),
        )
        for rank in range(shown)
    ]
    return maps, richest - shown


def union_of_states(patch_set: PatchSet) -> PatchSet:
    """The same sub-map with one state, in which a cell reflects as in the state in which it reflects most."""
    values = np.stack([patch.reflectance for patch in patch_set.patches])
    most = np.where(np.isnan(values), np.float32(-1.0), values).max(axis=0)
    most[most < 0.0] = np.nan
    return _with(patch_set, [Patch(0, sum(patch.support for patch in patch_set.patches), most)])


def one_state(patch_set: PatchSet, rank: int) -> PatchSet:
    """The same sub-map with its *rank*-th most common state alone, or with its rarest."""
    order = sorted(patch_set.patches, key=lambda patch: (-patch.support, patch.patch_id))
    return _with(patch_set, [order[min(rank, len(order) - 1)]])


def _with(patch_set: PatchSet, patches: Sequence[Patch]) -> PatchSet:
    return replace(patch_set, patches=tuple(patches), objects=())


def _ordinal(number: int) -> str:
    names = ("most common", "second most common", "third most common")
    return names[number - 1] if number <= len(names) else f"{number}th most common"
