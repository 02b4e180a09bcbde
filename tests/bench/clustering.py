"""How many states are found in simulated local maps, over numbers of maps and states, visibility and noise.

No recording and no mapping: the local maps are drawn, so that what is right is known, and what is wrong is the
clustering alone. A sub-map of 20 m2 has a wall that never changes and up to three things of which each map shows one
place: doors (a leaf in one of two angles) and boxes (of which the outline is seen).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, I8, I64
from dynmap_cli.clustering.local_maps import LocalMaps, align, shifted
from dynmap_cli.clustering.sequences import SequenceParams
from dynmap_cli.clustering.states import StateParams, recognise_states
from dynmap_cli.config import Config
from dynmap_cli.counting.em import FilterParams
from dynmap_cli.counting.evidence import EvidenceParams
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN
from dynmap_cli.evaluation.states import adjusted_rand_index
from tests.bench.tables import Table, number, percent
from tests.bench.worlds import Bench

ROWS, COLS, CELL_M = 80, 100, 0.05
"""4 m x 5 m in cells of 5 cm."""
_SETTINGS = Config().clustering
_PARAMS = StateParams(
    SequenceParams(),
    EvidenceParams(),
    FilterParams(),
    _SETTINGS.min_known_share,
    _SETTINGS.max_states,
    _SETTINGS.min_cells,
)


@dataclass(frozen=True)
class Case:
    """One kind of simulated sub-map.

    Attributes
    ----------
    maps : int
        Number of local maps.
    states : int
        Number of configurations among them, each in two maps at least, of which one sees everything: a
        configuration that none saw whole cannot be told.
    visibility : float
        Share of the cells that the other maps know; a straight edge parts them from what is hidden.
    noise : float
        Share of the known cells near a surface that show the opposite.
    shift : float
        Standard deviation of the shift of a map, cells.
    """

    maps: int
    states: int
    visibility: float = 0.8
    noise: float = 0.02
    shift: float = 0.5


SEVENTEEN = Case(17, 4)
VISIBILITY, NOISE = (0.6, 0.8, 1.0), (0.0, 0.02, 0.05)
ONE_STATE = tuple(
    Case(maps, 1, visibility, noise) for maps, visibility, noise in product((17, 30, 100), VISIBILITY, NOISE)
)
TABLE = tuple(
    Case(maps, states, visibility, noise)
    for maps, states, visibility, noise in product((5, 10, 17, 30, 100), range(1, 7), VISIBILITY, NOISE)
    if 2 * states <= maps
)

ROUGH = tuple(
    Case(maps, states, 0.6, 0.08) for maps in (5, 6, 7, 8) for states in (1, 2, 3) if 2 * states <= maps
)


@dataclass(frozen=True)
class Simulated:
    """Local maps, what segmentation would have marked, and the configuration (n,) of each map."""

    maps: LocalMaps
    contested: B1
    truth: I64


def simulate(case: Case, seed: int) -> Simulated:
    """Draw a sub-map and its local maps."""
    draw = np.random.default_rng(
        [seed, case.maps, case.states, round(100 * case.visibility), round(100 * case.noise)]
    )
    things = _things(draw)
    choices = list(product(*(range(len(places)) for places in things)))
    while len(choices) < case.states:
        things = _things(draw)
        choices = list(product(*(range(len(places)) for places in things)))
    chosen = draw.choice(len(choices), size=case.states, replace=False)
    truth = np.concatenate([np.tile(np.arange(case.states), 2), draw.integers(case.states, size=case.maps)])[
        : case.maps
    ]
    visibility = np.where(np.arange(case.maps) < case.states, 1.0, case.visibility)
    order = draw.permutation(case.maps)
    truth, visibility = truth[order], visibility[order]
    wall = np.zeros((ROWS, COLS), dtype=bool)
    wall[-4, :] = True
    pictures = []
    for choice in chosen:
        picture = wall.copy()
        for places, place in zip(things, choices[choice], strict=True):
            picture |= places[place]
        pictures.append(picture)
    occupied = np.stack(pictures)
    contested = occupied.any(axis=0) & ~occupied.all(axis=0) if case.states > 1 else occupied[0]
    near = ndimage.binary_dilation(occupied.any(axis=0), np.ones((3, 3), dtype=bool))
    states = np.stack(
        [_seen(occupied[k], near, share, case, draw) for k, share in zip(truth, visibility, strict=True)]
    )
    reflectance = np.where(states == UNKNOWN, np.nan, states).astype(np.float32)
    return Simulated(LocalMaps(states, reflectance, np.zeros(case.maps, dtype=bool)), contested, truth)


def _things(draw: np.random.Generator) -> list[list[B1]]:
    """One to three things, each with the cells it occupies at each of its places."""
    middles = [(18, 22), (18, 72), (52, 48)]
    order = draw.permutation(3)[: draw.integers(1, 4)]
    return [_door(draw, *middles[k]) if draw.random() < 0.4 else _box(draw, *middles[k]) for k in order]


def _door(draw: np.random.Generator, row: int, col: int) -> list[B1]:
    """A leaf of 0.9 m, along the row and turned by 60 to 120 degrees."""
    leaves = []
    for angle in (0.0, math.radians(draw.uniform(60, 120))):
        leaf = np.zeros((ROWS, COLS), dtype=bool)
        along = np.arange(0, 18, 0.5)
        leaf[
            (row - 8 + along * math.sin(angle)).astype(int), (col - 8 + along * math.cos(angle)).astype(int)
        ] = True
        leaves.append(leaf)
    return leaves


def _box(draw: np.random.Generator, row: int, col: int) -> list[B1]:
    """A box with sides of 0.3 to 0.8 m, at two to four places, the first of them outside."""
    height, width = (int(side) for side in draw.integers(6, 17, size=2))
    places = [np.zeros((ROWS, COLS), dtype=bool)]
    corners: list[tuple[int, int]] = []
    wanted = draw.integers(1, 4)
    while len(corners) < wanted:
        corner = (row - 12 + int(draw.integers(0, 9)), col - 18 + int(draw.integers(0, 21)))
        if any(abs(corner[0] - other[0]) < 4 and abs(corner[1] - other[1]) < 4 for other in corners):
            continue
        corners.append(corner)
        outline = np.zeros((ROWS, COLS), dtype=bool)
        outline[corner[0] : corner[0] + height, corner[1] : corner[1] + width] = True
        outline[corner[0] + 1 : corner[0] + height - 1, corner[1] + 1 : corner[1] + width - 1] = False
        places.append(outline)
    return places


def _seen(occupied: B1, near: B1, visibility: float, case: Case, draw: np.random.Generator) -> I8:
    """What a visit sees: hidden on one side of a line, flipped by noise, shifted as a whole.

    As in the evidence of a recording, no cell beside an occupied one is free.
    """
    states = np.where(occupied, OCCUPIED, FREE).astype(np.int8)
    flipped = near & (draw.random(states.shape) < case.noise)
    states = np.where(flipped, OCCUPIED + FREE - states, states).astype(np.int8)
    beside = ndimage.binary_dilation(states == OCCUPIED, np.ones((3, 3), dtype=bool))
    states[beside & (states == FREE)] = UNKNOWN
    angle = draw.uniform(0, 2 * np.pi)
    row, col = np.indices(states.shape)
    side = row * math.sin(angle) + col * math.cos(angle)
    states[side > np.quantile(side, visibility)] = UNKNOWN
    shift = np.clip(np.rint(draw.normal(0.0, case.shift, size=2)), -2, 2).astype(int)
    return shifted(states, (int(shift[0]), int(shift[1])), UNKNOWN).astype(np.int8)


@dataclass(frozen=True)
class Result:
    """What came of one simulated sub-map."""

    states: int
    rand_index: float
    assigned_share: float
    cpu_s: float


def judge(case: Case, seed: int) -> Result:
    """Cluster, and compare with the truth."""
    simulated = simulate(case, seed)
    started = time.thread_time()
    maps = align(simulated.maps)
    _, _, labels = recognise_states(maps, np.ones((ROWS, COLS), dtype=bool), simulated.contested, _PARAMS)
    seconds = time.thread_time() - started
    known = labels.patch >= 0
    index = adjusted_rand_index(labels.patch[known].tolist(), simulated.truth[known].tolist())
    return Result(np.unique(labels.patch[known]).size, index, float(known.mean()), seconds)


def tables(bench: Bench) -> list[Table]:
    """One table."""
    seeds = 1 if bench.quick else 4
    table = Table(
        "States in simulated local maps",
        [
            "The clustering alone: local maps of a sub-map of 20 m2 at 5 cm are drawn, with up to three doors and "
            "boxes, of which a map knows the share *visibility* of the cells, shows the share *noise* of those near "
            "a surface wrongly, and lies shifted by a standard deviation of half a cell. Each state is in two maps "
            "at least, of which one sees everything. The index compares the states of the maps that got one with "
            f"the truth. {seeds} seeds for each of the {len(TABLE)} cases of 5 to 100 maps, 1 to 6 states, "
            f"visibility {VISIBILITY[0]:g} to 1 and noise up to {NOISE[-1]:g}; 50 seeds of 17 maps with 4 states. "
            "*Rough*: 1 to 3 states in 5 to 8 maps that know 60 % of the cells, 8 % of those near a surface wrongly.",
        ],
        ["cases", "runs", "right number", "adjusted Rand index", "assigned", "CPU s, mean", "CPU s, largest"],
    )
    runs = [(case, judge(case, seed)) for case in TABLE for seed in range(seeds)]
    seventeen = [(SEVENTEEN, judge(SEVENTEEN, seed)) for seed in range(50)]
    one = [(case, judge(case, 100 + seed)) for case in ONE_STATE for seed in range(seeds)]
    rough = [(case, judge(case, 200 + seed)) for case in ROUGH for seed in range(2 * seeds)]
    table.add("17 maps of 4 states", lambda: _row(seventeen))
    table.add("one state, 17 maps or more", lambda: _row(one))
    table.add("rough, 5 to 8 maps", lambda: _row(rough))
    table.add("all", lambda: _row(runs))
    kinds: list[tuple[str, Sequence[float], Callable[[Case], float]]] = [
        ("maps", (5, 10, 17, 30, 100), lambda case: case.maps),
        ("states", range(1, 7), lambda case: case.states),
        ("visibility", VISIBILITY, lambda case: case.visibility),
        ("noise", NOISE, lambda case: case.noise),
    ]
    for name, values, value_of in kinds:
        for value in values:
            some = [(case, result) for case, result in runs if value_of(case) == value]
            table.add(f"{name} {value:g}", lambda some=some: _row(some))
    table.remark("states of simulated local maps", lambda: _short(seventeen, one, runs))
    return [table]


def _row(runs: Sequence[tuple[Case, Result]]) -> list[str]:
    """One row of the table."""
    results = [result for _, result in runs]
    seconds = [result.cpu_s for result in results]
    return [
        str(len(runs)),
        percent(_right(runs)),
        number(float(np.mean([result.rand_index for result in results]))),
        percent(float(np.mean([result.assigned_share for result in results]))),
        number(float(np.mean(seconds))),
        number(max(seconds)),
    ]


def _short(
    seventeen: Sequence[tuple[Case, Result]],
    one: Sequence[tuple[Case, Result]],
    runs: Sequence[tuple[Case, Result]],
) -> str:
    """The line of the short form."""
    return (
        f"right number of states: 17 maps of 4 {percent(_right(seventeen))}, "
        f"one state stays one {percent(_right(one))}, "
        f"5 to 100 maps of 1 to 6 states {percent(_right(runs))}"
    )


def _right(runs: Sequence[tuple[Case, Result]]) -> float:
    """Share of runs with the right number of states."""
    return float(np.mean([result.states == case.states for case, result in runs]))
