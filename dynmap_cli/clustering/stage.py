"""The door of the room: scans and sub-maps -> patches, the states of each area."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from dynmap_cli.domain.corrections import Merge
from dynmap_cli.domain.patches import PatchSet, Visit
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.edits import NAME as EDITS
from dynmap_cli.files.edits import read_edits
from dynmap_cli.files.known import FOUND_PATCHES, found_patches, read_known_patches
from dynmap_cli.files.patch_archive import read_patches, read_rounds, read_visits, write_patches
from dynmap_cli.files.registered import read_registered
from dynmap_cli.files.submaps import read_submaps
from dynmap_cli.progress import progress
from dynmap_cli.stage import Stage, StageContext

_BYTES_PER_CELL, _LEAST_BYTES = 10, 100_000


def needs(context: StageContext) -> tuple[str, int]:
    """Room for an image and a table of each state, in patches.zip and in that of before corrections."""
    submaps, most = read_submaps(context.run_dir / "submaps"), context.config.clustering.max_states
    n_cells = sum(submap.owned.size for submap in submaps)
    return f"up to {most} states of {len(submaps)} sub-maps", _LEAST_BYTES + _BYTES_PER_CELL * n_cells * most


def run(context: StageContext) -> dict[str, Any]:
    """Learn the states, give them the numbers of before, correct them by hand, write patches.zip."""
    from dynmap_cli.clustering.learning import learn_patch_map
    from dynmap_cli.clustering.numbering import keep_numbers

    log, trajectory = read_registered(context.scans_dir, context.run_dir / "map")
    submaps = read_submaps(context.run_dir / "submaps")
    with progress("cluster", len(submaps), "sub-maps") as tick:
        patch_sets, visits = learn_patch_map(
            log,
            trajectory.poses,
            submaps,
            context.config.clustering,
            threads=context.threads,
            on_submap=tick,
        )
    patch_sets, visits = keep_numbers(patch_sets, visits, read_known_patches(context.run_dir))
    return _write_corrected(context, submaps, patch_sets, visits)


def correct(context: StageContext) -> dict[str, Any]:
    """Correct the states that were learned before, where only names and merged states changed since then."""
    learned = found_patches(context.run_dir)
    rounds = read_rounds(learned)
    patch_sets = tuple(replace(one, rounds=rounds[one.submap_id]) for one in read_patches(learned))
    submaps = read_submaps(context.run_dir / "submaps")
    return _write_corrected(context, submaps, patch_sets, read_visits(learned))


def _write_corrected(
    context: StageContext,
    submaps: Sequence[SubMap],
    patch_sets: tuple[PatchSet, ...],
    visits: tuple[Visit, ...],
) -> dict[str, Any]:
    """Correct states by hand and write them; those that were learned too, where some are merged."""
    from dynmap_cli.clustering.corrections import apply_corrections
    from dynmap_cli.clustering.states import describe

    corrections = read_edits(context.run_dir)
    lines: list[str] = []
    learned = patch_sets
    if any(isinstance(one, Merge) for one in corrections):
        write_patches(context.out_dir / FOUND_PATCHES, submaps, patch_sets, visits)
        patch_sets, visits, lines = apply_corrections(patch_sets, visits, submaps, corrections)
    write_patches(context.out_dir / "patches.zip", submaps, patch_sets, visits)
    return {
        "submaps": len(submaps),
        "submaps_with_states": len(patch_sets),
        "patches": sum(len(patch_set.patches) for patch_set in patch_sets),
        "objects": sum(len(patch_set.objects) for patch_set in patch_sets),
        "visits": len(visits),
        "visits_assigned": sum(visit.patch is not None for visit in visits),
        "lines": [
            *(describe(patch_sets, visits, learned) or ["no states to learn: there is no sub-map"]),
            *lines,
        ],
    }


STAGE = Stage(
    name="cluster",
    title="learning the states of each area",
    section="clustering",
    folder="patches",
    reads=("scans/", "map/", "submaps/", "known/", EDITS),
    writes=("patches/patches.zip",),
    run=run,
    needs=needs,
)

CORRECT = replace(STAGE, title="correcting the states of each area", run=correct, has_kernels=False)
"""The same stage where only names and merged states changed since it was run: no state is learned again."""
