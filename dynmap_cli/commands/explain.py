"""`dynmap explain`: why an area is a sub-map, who saw what of it, and which states that makes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from dynmap_cli.commands.options import PATH, print_summary, reading_options
from dynmap_cli.commands.tables import table

_MARKS = {"on": "+", "off": "-", "unknown": "."}


@click.command("explain")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.argument("submap_id", metavar="ID", type=int)
@reading_options
def command(run_dir: Path, submap_id: int, as_json: bool) -> None:
    """Say of sub-map ID of RUN which evidence contradicts, which visits saw what, and which states they make."""
    from dynmap_cli.finished import explain

    found = explain(run_dir, submap_id)
    print_summary(found, [] if as_json else _lines(found), as_json=as_json)


def _lines(found: Mapping[str, Any]) -> list[str]:
    """All of it, for people."""
    (x, y), (width, height) = found["center_m"], found["size_m"]
    name = f" ({found['name']})" if found["name"] else ""
    how = "were added by hand" if found["by_hand"] else "are contested"
    head = (
        f"sub-map {found['submap']}{name} at ({x:.1f}, {y:.1f}), {width:.1f} x {height:.1f} m: "
        f"{found['contested_cells']} of {found['cells']} cells {how}"
    )
    parts = [_evidence_lines(found), _visit_lines(found), _state_lines(found), _object_lines(found)]
    return [head, *(line for part in parts if part for line in ["", *part])]


def _evidence_lines(found: Mapping[str, Any]) -> list[str]:
    """The windows that contradict one another."""
    evidence = found["evidence"]
    occupied, free = (_range(evidence[f"{what}_in_windows"]) for what in ("occupied", "free"))
    rule = (
        "added by hand, whatever the windows saw; they judge only cells in or beside which a beam ended at some time"
        if found["by_hand"]
        else f"contested: seen occupied in {evidence['windows_needed']} or more windows of {evidence['window_s']:g} s, "
        f"and free in as many, or once if larger than people are; these cells: occupied in {occupied}, free in {free}"
    )
    if found["recurring_cells"]:
        rule += (
            f"; {found['recurring_cells']} of them belong to a spot as wide as a person that was taken on three "
            "occasions or more, hours apart, and empty on as many"
        )
    rows = [
        (
            _time(window["start_s"]),
            _time(window["end_s"]),
            str(window["occupied_cells"]),
            str(window["free_cells"]),
            str(window["hits"]),
            f"{window['passed_cells']:.0f}",
        )
        for window in evidence["windows"]
    ]
    return [rule, *table(("window from", "to", "occupied cells", "free cells", "hits", "passed cells"), rows)]


def _visit_lines(found: Mapping[str, Any]) -> list[str]:
    """Who saw what."""
    if not found["visits"]:
        return ["visits: none, the robot never came near"]
    rows = [
        (
            str(visit["visit"]),
            visit["recording"],
            _time(visit["enter_s"]),
            _time(visit["leave_s"]),
            "-" if visit["state"] is None else str(visit["state"]),
            "-" if visit["membership"] is None else f"{visit['membership']:.3f}",
            visit["remark"],
        )
        for visit in found["visits"]
    ]
    return [
        "visits",
        *table(("visit", "recording", "enter", "leave", "state", "membership", "remark"), rows),
    ]


def _state_lines(found: Mapping[str, Any]) -> list[str]:
    """What the visits make."""
    if not found["states"]:
        return ["states: none, no visit saw enough"]
    rows = [
        (
            str(state["state"]),
            str(state["visits"]),
            _time(state["first_s"]),
            _time(state["last_s"]),
            str(state["occupied_cells"]),
            str(state["free_cells"]),
        )
        for state in found["states"]
    ]
    lines = [
        "states",
        *table(("state", "visits", "first seen", "last seen", "occupied cells", "free cells"), rows),
    ]
    if all(state["share_by_hour"] for state in found["states"]):
        hours = [[f"{share:.2f}" for share in state["share_by_hour"]] for state in found["states"]]
        header = ("hour (UTC)", *(f"state {state['state']}" for state in found["states"]))
        lines += table(header, [(str(hour), *shares) for hour, shares in enumerate(zip(*hours, strict=True))])
    lines.append(f"the state is the same a minute later with probability {found['stay_probability']:.3f}")
    if found["bic"]:
        best = max(range(len(found["bic"])), key=found["bic"].__getitem__) + 1
        scores = ", ".join(f"{count}: {value:.1f}" for count, value in enumerate(found["bic"], start=1))
        lines.append(
            f"BIC by the number of states: {scores}; {best} is best, what differs in too few cells is merged"
        )
    return lines


def _object_lines(found: Mapping[str, Any]) -> list[str]:
    """The same change, thing by thing."""
    if not found["objects"]:
        return []
    rows = [
        (
            str(thing["object"]),
            f"({thing['center_m'][0]:.1f}, {thing['center_m'][1]:.1f})",
            *(str(thing[column]) for column in ("cells", "on", "off", "unknown")),
            "".join(_MARKS[state] for state in thing["visits"].values()),
        )
        for thing in found["objects"]
    ]
    return [
        "objects: cells that switch together (+ on, - off, . unknown)",
        *table(("object", "at", "cells", "visits on", "off", "unknown", "in visits 0, 1, ..."), rows),
    ]


def _range(bounds: list[int]) -> str:
    """Lowest to highest."""
    return str(bounds[0]) if bounds[0] == bounds[1] else f"{bounds[0]} to {bounds[1]}"


def _time(stamp_s: str) -> str:
    """A stamp in seconds, for people."""
    from dynmap_cli.domain.times import readable_time
    from dynmap_cli.files.trajectory import parse_stamp

    return readable_time(parse_stamp(stamp_s))
