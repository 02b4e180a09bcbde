"""The states that areas take: the patch map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynmap_cli.arrays import B1, F32, I8
from dynmap_cli.domain.grid import FREE, OCCUPIED, UNKNOWN, GridFrame

OCCUPIED_REFLECTANCE, FREE_REFLECTANCE = 0.2, 0.1
"""A cell of a state is occupied from the first on, and free below the second; between them it is neither."""
VARYING_DIFFERENCE = 0.25
"""A cell varies if it is free in one state and its reflectance higher by more than this in another."""
NEVER_MAPPED = -1
"""Stands where the number of a patch does, for all states of a sub-map that no patch shows."""
SURE = 0.8
"""A state that is believed with this probability or more counts as seen; below it the state is undecided."""
ON, OFF, UNKNOWN_STATE = "on", "off", "unknown"


@dataclass(frozen=True, slots=True)
class Patch:
    """One state of a sub-map.

    Attributes
    ----------
    patch_id : int
        Number within the sub-map, from 0; the state seen most often comes first.
    support : int
        How many visits saw this state.
    reflectance : (rows, cols) float32
        Mean counting-map value of the visits; NaN = unknown, or a cell that another sub-map owns.
    share_by_hour : tuple of float
        Probability of this state in each hour of the day (UTC), 24 numbers, of which those of all patches add up to 1;
        empty where too few visits on too few days are known.
    """

    patch_id: int
    support: int
    reflectance: F32
    share_by_hour: tuple[float, ...] = ()

    @property
    def cells(self) -> I8:
        """(rows, cols) OCCUPIED, FREE or UNKNOWN."""
        cells = np.full(self.reflectance.shape, UNKNOWN, dtype=np.int8)
        cells[self.reflectance >= OCCUPIED_REFLECTANCE] = OCCUPIED
        cells[self.reflectance < FREE_REFLECTANCE] = FREE
        return cells


@dataclass(frozen=True, slots=True)
class ChangingObject:
    """Cells of a sub-map that switch together: what stands in one place, or does not.

    Attributes
    ----------
    object_id : int
        Number within the sub-map.
    cells : (rows, cols) bool
    states : mapping of int to str
        By number of the visit: ON = the cells are occupied, OFF = they are free, or UNKNOWN_STATE.
    """

    object_id: int
    cells: B1
    states: Mapping[int, str]

    def count(self, state: str) -> int:
        """How many visits saw this state."""
        return sum(seen == state for seen in self.states.values())


@dataclass(frozen=True, slots=True)
class PatchSet:
    """A sub-map with the states it takes, at least one.

    Attributes
    ----------
    submap_id : int
    frame : GridFrame
        The rectangle, on the cells of the whole map.
    varying : (rows, cols) bool
        Cells that are free in one state and reflect in another.
    patches : tuple of Patch
    stay_probability : float
        Probability that the state is the same one minute later.
    bic : tuple of float
        BIC (Eq. 1.19) of the models with 1, 2, ... states that were tried; empty where there was nothing to choose.
    rounds : tuple of (k, rows, cols) float32
        Means of the clusters of each of these models (of which some may be gone): 1 occupied, 0 free, NaN unknown. Only
        pictures need them; they are empty in a patch map that was read from a file.
    objects : tuple of ChangingObject
        The same changes, thing by thing; no cell belongs to two.
    """

    submap_id: int
    frame: GridFrame
    varying: B1
    patches: tuple[Patch, ...]
    stay_probability: float
    bic: tuple[float, ...] = ()
    rounds: tuple[F32, ...] = ()
    objects: tuple[ChangingObject, ...] = ()


@dataclass(frozen=True, slots=True)
class Visit:
    """One observation sequence (Eq. 1.17) of a sub-map.

    Attributes
    ----------
    submap_id, sequence : int
    recording : str
        Name of the recording it lies in.
    start_ns, end_ns : int
        Stamps of its first and last scan.
    patch : int or None
        The state it saw; None where it saw too little, a change, or nothing that fits.
    membership : float
        Of the patch, 0 to 1; NaN where patch is None.
    remark : str
        "" or why there is no patch: "saw too little", "saw the change", "fits no state".
    """

    submap_id: int
    sequence: int
    recording: str
    start_ns: int
    end_ns: int
    patch: int | None
    membership: float
    remark: str = ""


def cells_that_vary(patches: Sequence[Patch]) -> B1:
    """(rows, cols) whether a cell is free in one patch and reflects in another.

    Between two states that both reflect, the values differ with the angles from which a wall was seen.
    """
    values = np.stack([patch.reflectance for patch in patches])
    high = np.where(np.isnan(values), -np.inf, values).max(axis=0)
    low = np.where(np.isnan(values), np.inf, values).min(axis=0)
    return np.asarray((low < FREE_REFLECTANCE) & (high - low > VARYING_DIFFERENCE))
