"""The history of sub-maps: nothing of the visits is lost, and the counts are those of a plain loop."""

import csv
import io
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from dynmap_cli.domain.grid import GridFrame
from dynmap_cli.domain.patches import Visit
from dynmap_cli.domain.submaps import SubMap
from dynmap_cli.files.trajectory import parse_stamp
from dynmap_cli.history.timeline import TIMELINE_HEADER, as_csv, describe, histories_of
from dynmap_cli.report.curves import _Clock, draw_visits

S = 10**9


def visit(submap, number, second, state, remark=""):
    membership = math.nan if state is None else 0.75
    return Visit(submap, number, "a, b.mcap", second * S, (second + 4) * S + 1, state, membership, remark)


def submaps(*numbers):
    mask = np.ones((2, 2), dtype=bool)
    return [SubMap(number, GridFrame(0.05, 0.0, 0.0, 2, 2), 0, 0, mask, mask, 0.01) for number in numbers]


SUBMAPS = [replace(one, name="lab $door_") for one in submaps(*range(60))]
VISITS = st.lists(
    st.tuples(st.integers(0, 2), st.integers(0, 100_000), st.one_of(st.none(), st.integers(0, 3))),
    max_size=20,
).map(lambda rows: [visit(submap, k, second, state) for k, (submap, second, state) in enumerate(rows)])


@given(VISITS)
def test_every_visit_is_one_row_in_time_order(visits):
    rows = list(csv.DictReader(io.StringIO(as_csv(visits).decode())))
    assert len(rows) == len(visits)
    found = {(int(r["submap"]), int(r["visit"]), parse_stamp(r["enter_s"]), r["state"]) for r in rows}
    assert found == {
        (v.submap_id, v.sequence, v.start_ns, "" if v.patch is None else str(v.patch)) for v in visits
    }
    entered = [parse_stamp(row["enter_s"]) for row in rows]
    assert entered == sorted(entered)


@given(VISITS)
def test_counts_and_transitions_are_those_of_a_plain_loop(visits):
    for history in histories_of(submaps(0, 1, 2), visits, {}):
        own = sorted(
            (v for v in visits if v.submap_id == history.submap_id), key=lambda v: (v.start_ns, v.sequence)
        )
        seen, changes, last = {}, {}, None
        for one in own:
            if one.patch is None:
                continue
            seen[one.patch] = seen.get(one.patch, 0) + 1
            if last is not None and last != one.patch:
                changes[last, one.patch] = changes.get((last, one.patch), 0) + 1
            last = one.patch
        assert history.seen == seen
        assert history.transitions == changes
        assert sum(history.open_visits.values()) == len(own) - sum(seen.values())


def test_the_columns_and_the_remarks():
    visits = [
        visit(0, 0, 10, 1),
        visit(0, 1, 20, None, "saw the change"),
        visit(0, 2, 30, None, "saw too little"),
        visit(0, 3, 40, None, "fits no state"),
    ]
    lines = as_csv(visits).decode().splitlines()
    assert lines[0] == TIMELINE_HEADER
    assert lines[1] == '0,0,"a, b.mcap",10.000000000,14.000000001,1,0.750000,'
    assert [line.rpartition(",")[2] for line in lines[2:]] == [
        "saw the change",
        "saw too little",
        "fits no state",
    ]


def test_the_sentence_says_it_all():
    visits = [visit(4, k, 10 * k, state, "saw the change") for k, state in enumerate((0, 1, None, 1, 0))]
    (history,) = histories_of(submaps(4), visits, {4: 0.9})
    assert describe(history, "(1.0, 2.0)") == (
        "sub-map 4 at (1.0, 2.0): 5 visits (state 0 in 2, state 1 in 2), 1 saw the change, "
        "2 transitions (0 -> 1: 1, 1 -> 0: 1), stays for a minute with probability 0.900"
    )
    (nobody,) = histories_of(submaps(5), visits, {})
    assert describe(nobody, "(0.0, 0.0)") == "sub-map 5 at (0.0, 0.0): 0 visits"


@given(VISITS)
def test_time_never_runs_back_in_the_figure_and_pauses_are_short(visits):
    if not visits:
        return
    clock = _Clock(visits, min(one.start_ns for one in visits))
    stamps = sorted({stamp for v in visits for stamp in (v.start_ns, v.end_ns)})
    places = [clock.at(stamp) for stamp in stamps]
    assert places[0] == 0.0
    assert places[-1] <= clock.width * (1 + 1e-9)
    for (before, after), (left, right) in zip(pairwise(stamps), pairwise(places), strict=True):
        assert right >= left
        if after - before <= 300 * S:
            assert abs((right - left) - (after - before) * 1e-9) < 1e-3


def test_the_figure_is_drawn_with_and_without_pauses_and_visits():
    near = [visit(k % 2, k, 30 * k, k % 3 if k % 3 < 2 else None) for k in range(8)]
    far = [visit(0, 9, 90_000, 1), visit(1, 9, 1_772_438_400, 0)]
    for visits in (near, near + far, []):
        image = np.asarray(Image.open(io.BytesIO(draw_visits(visits, SUBMAPS, 0))))
        assert (draw_visits(visits[::-1], SUBMAPS, 0) == draw_visits(visits, SUBMAPS, 0)) is True
        assert image.shape[1] == 800
