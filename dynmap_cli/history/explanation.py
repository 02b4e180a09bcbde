"""What is known of one sub-map: why it is one, who saw what of it, and which states that makes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dynmap_cli.domain.grid import FREE, OCCUPIED, GridFrame
from dynmap_cli.domain.patches import OFF, ON, UNKNOWN_STATE, ChangingObject, PatchSet, Visit
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.trajectory import format_stamp
from dynmap_cli.history.evidence import SubMapEvidence
from dynmap_cli.history.timeline import in_time_order


def explanation_of(
    submap: SubMap, evidence: SubMapEvidence, visits: Sequence[Visit], patch_set: PatchSet | None
) -> dict[str, Any]:
    """Collect it as plain numbers and words.

    Parameters
    ----------
    submap : SubMap
    evidence : SubMapEvidence
    visits : sequence of Visit
        Of this sub-map.
    patch_set : PatchSet or None
        None where no state is known.
    """
    return {
        "submap": submap.submap_id,
        "name": submap.name or None,
        "by_hand": submap.by_hand,
        "center_m": list(submap.center_m),
        "size_m": list(submap.size_m),
        "cells": int(submap.contested.size),
        "contested_cells": int(submap.contested.sum()),
        "recurring_cells": 0 if submap.recurring is None else int(submap.recurring.sum()),
        "evidence": _evidence(evidence),
        "visits": [_visit(visit) for visit in in_time_order(visits)],
        "states": _states(submap, visits, patch_set) if patch_set else [],
        "objects": [_object(thing, patch_set.frame) for thing in patch_set.objects] if patch_set else [],
        "bic": list(patch_set.bic) if patch_set else [],
        "stay_probability": patch_set.stay_probability if patch_set else None,
    }


def _evidence(evidence: SubMapEvidence) -> dict[str, Any]:
    """Windows, and the range over the contested cells of the number of windows that saw them so."""
    return {
        "occupied_in_windows": [int(evidence.occupied.min()), int(evidence.occupied.max())],
        "free_in_windows": [int(evidence.free.min()), int(evidence.free.max())],
        "windows": [
            {
                "start_s": format_stamp(window.start_ns),
                "end_s": format_stamp(window.end_ns),
                "occupied_cells": window.occupied,
                "free_cells": window.free,
                "hits": window.hits,
                "passed_cells": round(window.passed_cells, 1),
            }
            for window in evidence.windows
        ],
    }


def _visit(visit: Visit) -> dict[str, Any]:
    """One visit."""
    known = visit.patch is not None
    return {
        "visit": visit.sequence,
        "recording": visit.recording,
        "enter_s": format_stamp(visit.start_ns),
        "leave_s": format_stamp(visit.end_ns),
        "state": visit.patch,
        "membership": round(visit.membership, 6) if known else None,
        "remark": visit.remark,
    }


def _object(thing: ChangingObject, frame: GridFrame) -> dict[str, Any]:
    """One object, with what each visit saw of it."""
    return {
        "object": thing.object_id,
        "center_m": [
            round(float(value), 3) for value in frame.to_points(np.argwhere(thing.cells)).mean(axis=0)
        ],
        "cells": int(thing.cells.sum()),
        **{state: thing.count(state) for state in (ON, OFF, UNKNOWN_STATE)},
        "visits": {str(visit): state for visit, state in sorted(thing.states.items())},
    }


def _states(submap: SubMap, visits: Sequence[Visit], patch_set: PatchSet) -> list[dict[str, Any]]:
    """The states, with what they hold of the contested cells."""
    rows = []
    for patch in patch_set.patches:
        seen = in_time_order([visit for visit in visits if visit.patch == patch.patch_id])
        cells = patch.cells[submap.contested]
        rows.append(
            {
                "state": patch.patch_id,
                "visits": patch.support,
                "first_s": format_stamp(seen[0].start_ns) if seen else None,
                "last_s": format_stamp(seen[-1].end_ns) if seen else None,
                "occupied_cells": int((cells == OCCUPIED).sum()),
                "free_cells": int((cells == FREE).sum()),
                "share_by_hour": list(patch.share_by_hour),
            }
        )
    return rows
