"""The maps as the filter sees them: likelihood fields of map and patches in one pool, and surfaces."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from dynmap_cli.arrays import B1, F32, F64, I32, I64, U8
from dynmap_cli.domain.grid import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, GridFrame, OccupancyGrid
from dynmap_cli.domain.patches import PatchSet
from dynmap_cli.errors import ArtifactError
from dynmap_cli.localization.beliefs.combinations import SOLID_REFLECTANCE, on_in_patches, switches_of
from dynmap_cli.localization.beliefs.priors import prior_by_hour
from dynmap_cli.localization.sensing.sensor import end_log_likelihood
from dynmap_cli.localization.sensing.surfaces import surface_codes
from dynmap_cli.localization.settings import LocalizationSettings

EXPLAINED_M = 0.2
"""An end this close to something in the map is explained by it: says nothing against a pose."""
ON_MAP_M, ON_MAP_CELLS = 0.12, 1.5
"""An end further away than both from all there is in the map may show something that stands before a wall."""
BESIDE_CELLS = 2
"""So far beside what differs between states its edges may lie, as visits lie up to a cell apart."""
MARGIN_M = 1.0
"""Around the map, so that ends just beyond a wall at its edge are still near it."""


@dataclass(frozen=True, slots=True)
class SubMapStates:
    """A sub-map with what its states look like.

    Attributes
    ----------
    submap_id : int
    patch_ids : tuple of int
        Of each state.
    row, col : int
        Lower left cell of the rectangle in the pool's frame.
    frame : GridFrame
        The rectangle.
    owned : (rows, cols) bool
        Cells that the states are asked about; what the others hold stands in the map, or belongs to another sub-map.
    field_start : (n_states,) int64
        Where the field of each state starts in the pool.
    likelihoods : (n_states, rows, cols) float32
        The fields, not as logarithms, for mixing.
    explained : (n_states, rows, cols) bool
        Cells within `EXPLAINED_M` of something in the map in that state.
    on_map : (n_states, rows, cols) bool
        Cells from which it is not further than `ON_MAP_M` or `ON_MAP_CELLS`.
    surfaces : (n_states, rows, cols) uint8
        What blocks beams in each state, see `surface_codes`.
    passes : (n_states, rows, cols) float32
        Share of the beams that pass each cell in each state; NaN where nothing is and none came.
    prior : (25, n_states) float64
        Belief before the first look, by hour of the day, see `prior_by_hour`.
    stay_probability : float
        Probability that the state is the same one minute later.
    drawn : (n_states,) float64
        Probability of each state after a change.
    n_objects : int
    switches : (n_pairs, 3) int64
        An object, a state that tells it on from off, and which from; by objects.
    """

    submap_id: int
    patch_ids: tuple[int, ...]
    row: int
    col: int
    frame: GridFrame
    owned: B1
    field_start: I64
    likelihoods: F32
    explained: B1
    on_map: B1
    surfaces: U8
    passes: F32
    prior: F64
    stay_probability: float
    drawn: F64
    n_objects: int
    switches: I64

    @property
    def n_states(self) -> int:
        """How many states are known."""
        return len(self.patch_ids)

    @property
    def rectangle_m(self) -> tuple[float, float, float, float]:
        """Lowest x, lowest y, highest x, highest y in the map frame."""
        x, y, size = self.frame.origin_x_m, self.frame.origin_y_m, self.frame.resolution_m
        return x, y, x + self.frame.cols * size, y + self.frame.rows * size

    def windows(self) -> I32:
        """(n_states, 5) int32 rows for `field_log_likelihoods`."""
        rows = [
            [self.row, self.col, self.frame.rows, self.frame.cols, int(start)] for start in self.field_start
        ]
        return np.array(rows, dtype=np.int32).reshape(-1, 5)


@dataclass(frozen=True, slots=True)
class MapPool:
    """All maps of a place.

    Attributes
    ----------
    frame : GridFrame
        Of the whole map, with a margin of unknown cells.
    pool : (n,) float32
        Log-likelihood of an end in each cell: the field of the whole map, then those of all states.
        Inside the rectangles the first holds the mixture that was painted last.
    start_field : (rows * cols,) float32
        A blunter field of the union of all states, for the lattice of a global start.
    free : (rows, cols) bool
        Where the robot may be.
    explained, on_map : (rows, cols) bool
        Cells near the static map, as for `SubMapStates`.
    surfaces : (rows, cols) uint8
        What blocks beams for good: the map without the rectangles.
    submaps : tuple of SubMapStates
    log_pass : (n,) float32 or None
        ln(1 - m) of each cell, laid out and painted as the pool; only for `sensor: beam`.
    """

    frame: GridFrame
    pool: F32
    start_field: F32
    free: B1
    explained: B1
    on_map: B1
    surfaces: U8
    submaps: tuple[SubMapStates, ...]
    log_pass: F32 | None = None

    def paint(self, number: int, belief: F64) -> None:
        """Let the map show the mixture of the states of a sub-map under a belief (n_states,)."""
        submap = self.submaps[number]
        self._paint(self.pool, submap, np.tensordot(belief, submap.likelihoods, axes=1))
        if self.log_pass is not None:
            start, n_cells = int(submap.field_start[0]), submap.likelihoods.size
            passes = np.exp(self.log_pass[start : start + n_cells]).reshape(submap.likelihoods.shape)
            self._paint(self.log_pass, submap, np.tensordot(belief, passes, axes=1))

    def _paint(self, pool: F32, submap: SubMapStates, mixture: F64) -> None:
        """Write the logarithm of a mixture (rows, cols) into the field of the whole map."""
        field = pool[: self.frame.rows * self.frame.cols].reshape(self.frame.shape)
        window = field[
            submap.row : submap.row + submap.frame.rows, submap.col : submap.col + submap.frame.cols
        ]
        window[submap.owned] = np.log(mixture)[submap.owned].astype(np.float32)


def make_map_pool(
    grid: OccupancyGrid, patch_sets: Sequence[PatchSet], settings: LocalizationSettings
) -> MapPool:
    """Lay out the fields of a map and of its patches.

    Parameters
    ----------
    grid : OccupancyGrid
        The whole map; its cells count outside the rectangles of the patch sets.
    patch_sets : sequence of PatchSet
        Sets without a patch are left out: the map says all that is known there.
    settings : LocalizationSettings
    """
    sets = [patch_set for patch_set in patch_sets if patch_set.patches]
    frame = _common_frame(grid.frame, sets)
    cells = _placed(grid, frame)
    solid = [_solid_states(patch_set) for patch_set in sets]
    occupied = cells == OCCUPIED
    owner = _owners(frame, sets, solid, occupied)
    static = occupied & (owner < 0)
    union = _union(static, owner, sets, solid, frame)
    distance = _far_at_the_border(_distance_m(static, frame.resolution_m))
    start = frame.rows * frame.cols
    submaps, fields = [], [end_log_likelihood(distance, settings.sigma_hit, settings).ravel()]
    for number, patch_set in enumerate(sets):
        submap, own_fields = _submap_states(
            patch_set, solid[number], union, owner, number, frame, start, settings
        )
        submaps.append(submap)
        fields.append(own_fields.ravel())
        start += own_fields.size
    if start >= 2**31:
        msg = f"the map has {start} cells; at most {2**31 - 1} fit. Build it with a larger map.resolution_m."
        raise ArtifactError(msg)
    blunt = max(settings.sigma_hit, settings.start_pitch_m)
    union_distance = _far_at_the_border(_distance_m(union, frame.resolution_m))
    pool = MapPool(
        frame=frame,
        pool=np.concatenate(fields),
        start_field=end_log_likelihood(union_distance, blunt, settings).ravel(),
        free=(cells == FREE) | ((owner >= 0) & ~union),
        explained=distance <= EXPLAINED_M,
        on_map=distance <= _on_map_m(frame),
        surfaces=surface_codes(static),
        submaps=tuple(submaps),
    )
    for number, submap in enumerate(pool.submaps):
        pool.paint(number, np.full(submap.n_states, 1.0 / submap.n_states))
    return pool


def _common_frame(frame: GridFrame, sets: Sequence[PatchSet]) -> GridFrame:
    """Smallest frame on the cells of the map that holds the map, all rectangles and a margin."""
    row0, col0, row1, col1 = 0, 0, frame.rows, frame.cols
    for patch_set in sets:
        row, col = _place(patch_set.frame, frame)
        row0, col0 = min(row0, row), min(col0, col)
        row1, col1 = max(row1, row + patch_set.frame.rows), max(col1, col + patch_set.frame.cols)
    margin = math.ceil(MARGIN_M / frame.resolution_m)
    if (row1 - row0) * (col1 - col0) > MAX_CELLS:
        msg = (
            f"the sub-maps in patches.zip lie far from the map: both together are {row1 - row0} x {col1 - col0} cells, "
            f"at most {MAX_CELLS} are allowed. Run `dynmap cluster` again with --force."
        )
        raise ArtifactError(msg)
    return frame.window(row0 - margin, col0 - margin, row1 - row0 + 2 * margin, col1 - col0 + 2 * margin)


def _place(inner: GridFrame, outer: GridFrame) -> tuple[int, int]:
    """Row and column of a rectangle's lower left cell in the frame of the map."""
    row = (inner.origin_y_m - outer.origin_y_m) / outer.resolution_m
    col = (inner.origin_x_m - outer.origin_x_m) / outer.resolution_m
    aligned = max(abs(row - round(row)), abs(col - round(col))) < 0.01
    if not aligned or abs(inner.resolution_m - outer.resolution_m) > 1e-6:
        msg = (
            f"patches lie on other cells ({inner.resolution_m:g} m at {inner.origin_x_m:g}, "
            f"{inner.origin_y_m:g}) than the map ({outer.resolution_m:g} m). "
            "Run `dynmap segment` and `dynmap cluster` again."
        )
        raise ArtifactError(msg)
    return round(row), round(col)


def _placed(grid: OccupancyGrid, frame: GridFrame) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
    """The cells of the map in the larger frame."""
    cells = np.full(frame.shape, UNKNOWN, dtype=np.int8)
    row, col = _place(grid.frame, frame)
    cells[row : row + grid.frame.rows, col : col + grid.frame.cols] = grid.cells
    return cells


def slices_of(inner: GridFrame, outer: GridFrame) -> tuple[slice, slice]:
    """Where a rectangle lies in the frame of the map."""
    row, col = _place(inner, outer)
    return slice(row, row + inner.rows), slice(col, col + inner.cols)


def _owners(frame: GridFrame, sets: Sequence[PatchSet], solid: Sequence[B1], occupied: B1) -> I32:
    """Index of the patch set that each cell belongs to, -1 = none, so that the map says what is there.

    A sub-map of several states owns what is known within `BESIDE_CELLS` of where these differ, or of what is solid in
    all of them and not in the map: of the walls around, the map has seen more than the visits of any state. Rectangles
    may overlap, but each cell is known to the states of one sub-map only.
    """
    owner = np.full(frame.shape, -1, dtype=np.int32)
    for number, (patch_set, states) in enumerate(zip(sets, solid, strict=True)):
        known = np.isfinite([patch.reflectance for patch in patch_set.patches]).any(axis=0)
        if len(patch_set.patches) > 1:
            in_map = occupied[slices_of(patch_set.frame, frame)]
            around = np.ones((3, 3), dtype=bool)
            lacking = states.all(axis=0) & ~ndimage.binary_dilation(in_map, around, BESIDE_CELLS)
            differ = states.any(axis=0) & ~states.all(axis=0)
            known &= ndimage.binary_dilation(differ | lacking, around, BESIDE_CELLS)
        window = owner[slices_of(patch_set.frame, frame)]
        window[known & (window < 0)] = number
    return owner


def _solid_states(patch_set: PatchSet) -> B1:
    """(n_states, rows, cols) what is solid in each state."""
    return np.asarray(_reflectances(patch_set) >= SOLID_REFLECTANCE)


def _reflectances(patch_set: PatchSet) -> F64:
    """(n_states, rows, cols) share of the beams that end in each cell.

    A cell that a state leaves open is taken from the mean of the others: what is not known must not tell
    states apart.
    """
    values = np.stack([patch.reflectance for patch in patch_set.patches]).astype(np.float64)
    known = np.isfinite(values)
    mean = np.where(known, values, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    return np.asarray(np.where(known, values, mean))


def _passes(patch_set: PatchSet, solid: B1) -> F32:
    """(n_states, rows, cols) share of the beams that pass each cell; NaN where nothing is solid and none came."""
    came = np.isfinite([patch.reflectance for patch in patch_set.patches])
    return np.where(came | solid, 1.0 - _reflectances(patch_set), np.nan).astype(np.float32)


def _union(static: B1, owner: I32, sets: Sequence[PatchSet], solid: Sequence[B1], frame: GridFrame) -> B1:
    """What is solid in the static map or in any state."""
    union = static.copy()
    for number, patch_set in enumerate(sets):
        place = slices_of(patch_set.frame, frame)
        union[place] |= solid[number].any(axis=0) & (owner[place] == number)
    return union


def _distance_m(solid: B1, resolution_m: float) -> F64:
    """Distance of each cell from the nearest solid one."""
    if not bool(solid.any()):
        return np.full(solid.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(~solid) * resolution_m)


def _on_map_m(frame: GridFrame) -> float:
    """How far from a solid cell an end is still on it, metres."""
    return max(ON_MAP_M, ON_MAP_CELLS * frame.resolution_m)


def _far_at_the_border(distance_m: F64) -> F64:
    """The outermost cells stand for all that is outside, which is far from everything."""
    inner = distance_m[1:-1, 1:-1].copy()
    return np.pad(inner, 1, constant_values=np.inf)


def _submap_states(
    patch_set: PatchSet,
    solid: B1,
    union: B1,
    owner: I32,
    number: int,
    frame: GridFrame,
    start: int,
    settings: LocalizationSettings,
) -> tuple[SubMapStates, F32]:
    """Fields and surfaces of the states of one sub-map.

    Around the rectangle the states see the static map and the union of the other sub-maps' states.
    """
    row, col = _place(patch_set.frame, frame)
    reach = int(np.ceil(settings.laser_likelihood_max_dist / frame.resolution_m)) + 1
    top, left = max(row - reach, 0), max(col - reach, 0)
    around = (
        slice(top, row + patch_set.frame.rows + reach),
        slice(left, col + patch_set.frame.cols + reach),
    )
    inner = (
        slice(row - top, row - top + patch_set.frame.rows),
        slice(col - left, col - left + patch_set.frame.cols),
    )
    owned = owner[slices_of(patch_set.frame, frame)] == number
    distances, surfaces = [], []
    for state in solid:
        world = union[around].copy()
        window = world[inner]
        window[owned] = state[owned]
        distances.append(_distance_m(world, frame.resolution_m)[inner])
        surfaces.append(np.where(owned, surface_codes(world)[inner], 0))
    distance = np.stack(distances)
    fields = end_log_likelihood(distance, settings.sigma_hit, settings)
    n_cells = patch_set.frame.rows * patch_set.frame.cols
    submap = SubMapStates(
        submap_id=patch_set.submap_id,
        patch_ids=tuple(patch.patch_id for patch in patch_set.patches),
        row=row,
        col=col,
        frame=patch_set.frame,
        owned=owned,
        field_start=start + n_cells * np.arange(len(patch_set.patches), dtype=np.int64),
        likelihoods=np.exp(fields),
        explained=distance <= EXPLAINED_M,
        on_map=distance <= _on_map_m(frame),
        surfaces=np.stack(surfaces).astype(np.uint8),
        passes=_passes(patch_set, solid),
        prior=prior_by_hour(patch_set.patches, settings.prior),
        stay_probability=patch_set.stay_probability,
        drawn=prior_by_hour(patch_set.patches, "uniform")[-1],
        n_objects=len(patch_set.objects),
        switches=switches_of(on_in_patches(patch_set)),
    )
    return submap, fields
