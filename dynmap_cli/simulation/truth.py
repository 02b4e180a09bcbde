"""`<LOG>.truth/`: what was really there, beside a simulated recording."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from dynmap_cli.domain.poses import Trajectory, transform_points
from dynmap_cli.files.pgm import write_map
from dynmap_cli.files.trajectory import format_stamp, write_tum
from dynmap_cli.simulation.run import SimulatedRun
from dynmap_cli.simulation.sensing import FIRST_OBJECT, MIXED, MOVING, NO_RETURN, STATIC
from dynmap_cli.simulation.shapes import Shapes

CLASSES = {
    "static": STATIC,
    "moving": MOVING,
    "no_return": NO_RETURN,
    "mixed": MIXED,
    "first_object": FIRST_OBJECT,
}


def write_truth(folder: Path, run: SimulatedRun) -> None:
    """Write the truth of a run into an empty folder.

    trajectory.tum: pose at each header stamp; beams.npz: stamps_ns, beam_class, object_states per scan;
    objects.csv: every change of state; map.pgm and map.yaml: what never changes; truth.json: the rest.
    """
    write_tum(folder / "trajectory.tum", Trajectory(run.log.stamps_ns, run.true_poses))
    np.savez_compressed(
        folder / "beams.npz",
        stamps_ns=run.log.stamps_ns,
        beam_class=run.beam_class,
        object_states=run.object_states,
    )
    rows = sorted(
        (time, thing.name, thing.state_names[state])
        for thing in run.objects
        for time, state in zip(thing.times_s.tolist(), thing.states.tolist(), strict=True)
    )
    start_ns = round(run.scenario.start.timestamp() * 1e6) * 1000
    text = "".join(
        f"{format_stamp(start_ns + round(time * 1e9))},{name},{state}\n" for time, name, state in rows
    )
    (folder / "objects.csv").write_text("stamp_s,object,state\n" + text, encoding="utf-8")
    write_map(folder, "map", run.true_map)
    (folder / "truth.json").write_text(json.dumps(_record(run), indent=1) + "\n", encoding="utf-8")


def summarize(run: SimulatedRun) -> dict[str, Any]:
    """Count what a run contains; "lines" are sentences for people."""
    log = run.log
    seconds = float(log.stamps_ns[-1] - log.stamps_ns[0]) * 1e-9 if log.n_scans else 0.0
    ended = int((run.beam_class != NO_RETURN).sum())
    counts = {
        "moving": int((run.beam_class == MOVING).sum()),
        "changing": int((run.beam_class >= FIRST_OBJECT).sum()),
    }
    length_m = Trajectory(log.stamps_ns, run.true_poses).length_m()
    changes = sum(thing.times_s.size - 1 for thing in run.objects)
    often = "once" if changes == 1 else f"{changes} times"
    lines = [
        f"{log.n_scans} scans of {log.n_beams} beams in {seconds:.1f} s, {length_m:.1f} m driven",
        f"{len(run.objects)} doors and boxes change state {often}, {run.movers} people and vehicles move",
    ]
    lines += [
        f"{100.0 * count / max(ended, 1):.2f} % of the end points are {name}"
        for name, count in counts.items()
    ]
    return {
        "scans": log.n_scans,
        "beams": log.n_beams,
        "seconds": round(seconds, 3),
        "driven_m": round(length_m, 3),
        "objects": len(run.objects),
        "changes": changes,
        "movers": run.movers,
        "end_points": ended,
        **{f"end_points_{name}": count for name, count in counts.items()},
        "lines": lines,
    }


def _record(run: SimulatedRun) -> dict[str, Any]:
    """What truth.json says: codes, objects with their places in the map frame, and the scenario itself."""
    turn_rad = math.radians(run.scenario.turn_deg)
    objects = [
        {
            "name": thing.name,
            "class": FIRST_OBJECT + number,
            "states": list(thing.state_names),
            "bounds_m": _bounds(run.shapes, number, turn_rad),
        }
        for number, thing in enumerate(run.objects)
    ]
    return {"classes": CLASSES, "objects": objects, "scenario": run.scenario.model_dump(mode="json")}


def _bounds(shapes: Shapes, number: int, turn_rad: float) -> list[float]:
    """Bounding box of an object in all its states: lowest x, y, highest x, y in the map frame."""
    mine = shapes.segments[shapes.segment_gates[:, 0] == number].reshape(-1, 2)
    points = np.concatenate([mine, shapes.circles[shapes.circle_gates[:, 0] == number, :2]])
    points = transform_points(np.array([0.0, 0.0, turn_rad]), points)
    return [round(value, 4) for value in (*points.min(axis=0).tolist(), *points.max(axis=0).tolist())]
