"""`dynmap explain`: why an area is a sub-map, who saw what of it, and which states that makes."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from dynmap_cli.commands.options import PATH, print_summary, reading_options
from dynmap_cli.commands.tables import table
from dynmap_cli.domain.points import point_for_people
from dynmap_cli.domain.times import readable_time

_MARKS = {"on": "+", "off": "-", "unknown": "."}


@click.command("explain", short_help="Say why an area of RUN is a sub-map.")
@click.argument("run_dir", metavar="RUN", type=PATH)
@click.argument("submap_id", metavar="ID", type=int)
@reading_options
def command(run_dir: Path, submap_id: int, as_json: bool) -> None:
    """Say of sub-map ID of RUN which evidence contradicts, which visits saw what, and which states they make.

    `dynmap timeline RUN` lists the IDs.
    """
    from dynmap_cli.runs.finished import explain

    found = explain(run_dir, submap_id)
    print_summary(found, [] if as_json else _lines(found), as_json=as_json)


class _Clock:
    """Times for people: t, the seconds from the first scan of the recording, as `localize` says them."""

    def __init__(self, recordings: Sequence[Mapping[str, str]]) -> None:
        self._names = [one["name"] for one in recordings]
        self._starts_ns = [_nanoseconds(one["start_s"]) for one in recordings]

    @property
    def legend(self) -> str:
        """What the times are counted from."""
        starts = zip(self._names, map(readable_time, self._starts_ns), strict=True)
        return f"t in seconds from the first scan of {', '.join(f'{name} ({time})' for name, time in starts)}"

    def at(self, stamp_s: str, begun_s: str | None = None) -> str:
        """Say t of a stamp, in the recording of what had begun then."""
        start_ns = self._starts_ns[self._number(begun_s or stamp_s)]
        return f"{(_nanoseconds(stamp_s) - start_ns) * 1e-9:.1f}"

    def named(self, stamp_s: str | None) -> str:
        """Say t of a stamp, and which recording it lies in if there are several."""
        if stamp_s is None:
            return "-"
        name = f" in {self._names[self._number(stamp_s)]}" if len(self._names) > 1 else ""
        return self.at(stamp_s) + name

    def _number(self, stamp_s: str) -> int:
        """The recording that was the last to begin before a stamp."""
        return max(bisect_right(self._starts_ns, _nanoseconds(stamp_s)) - 1, 0)


def _lines(found: Mapping[str, Any]) -> list[str]:
    """All of it, for people."""
    width, height = found["size_m"]
    name = f" ({found['name']})" if found["name"] else ""
    how = "were added by hand" if found["by_hand"] else "are contested"
    head = (
        f"sub-map {found['submap']}{name} at {point_for_people(*found['center_m'])}, {width:.1f} x {height:.1f} m: "
        f"{found['contested_cells']} of {found['cells']} cells {how}"
    )
    clock = _Clock(found["recordings"])
    parts = [
        [clock.legend],
        _evidence_lines(found, clock),
        _visit_lines(found, clock),
        _state_lines(found, clock),
        _object_lines(found),
    ]
    return [head, *(line for part in parts if part for line in ["", *part])]


def _evidence_lines(found: Mapping[str, Any], clock: _Clock) -> list[str]:
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
            clock.named(window["start_s"]),
            clock.at(window["end_s"], window["start_s"]),
            str(window["occupied_cells"]),
            str(window["free_cells"]),
            str(window["hits"]),
            f"{window['passed_cells']:.0f}",
        )
        for window in evidence["windows"]
    ]
    return [
        rule,
        *table(("window from t", "to t", "occupied cells", "free cells", "hits", "passed cells"), rows),
    ]


def _visit_lines(found: Mapping[str, Any], clock: _Clock) -> list[str]:
    """Who saw what."""
    if not found["visits"]:
        return ["visits: none, the robot never came near"]
    rows = [
        (
            str(visit["visit"]),
            visit["recording"],
            clock.at(visit["enter_s"]),
            clock.at(visit["leave_s"], visit["enter_s"]),
            "-" if visit["state"] is None else str(visit["state"]),
            "-" if visit["membership"] is None else f"{visit['membership']:.3f}",
            visit["remark"],
        )
        for visit in found["visits"]
    ]
    return [
        "visits",
        *table(("visit", "recording", "enter t", "leave t", "state", "membership", "remark"), rows),
    ]


def _state_lines(found: Mapping[str, Any], clock: _Clock) -> list[str]:
    """What the visits make."""
    if not found["states"]:
        return ["states: none, no visit saw enough"]
    rows = [
        (
            str(state["state"]),
            str(state["visits"]),
            clock.named(state["first_s"]),
            clock.named(state["last_s"]),
            str(state["occupied_cells"]),
            str(state["free_cells"]),
        )
        for state in found["states"]
    ]
    lines = [
        "states",
        *table(("state", "visits", "first seen t", "last seen t", "occupied cells", "free cells"), rows),
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
            point_for_people(*thing["center_m"]),
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


def _nanoseconds(stamp_s: str) -> int:
    """A stamp as the file has it."""
    from dynmap_cli.files.trajectory import parse_stamp

    return parse_stamp(stamp_s)
