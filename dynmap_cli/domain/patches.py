"""The states that areas take: the patch map."""

from __future__ import annotations

from dataclasses import dataclass

from dynmap_cli.arrays import B1, F32
from dynmap_cli.domain.grid import GridFrame


@dataclass(frozen=True, slots=True)
class Patch:
    """One state of a sub-map.

    Attributes
    ----------
    patch_id : int
        Number within the sub-map, from 0.
    support : int
        How many visits saw this state.
    reflectance : (rows, cols) float32
        Mean counting-map value of the visits; NaN = unknown.
    """

    patch_id: int
    support: int
    reflectance: F32


@dataclass(frozen=True, slots=True)
class PatchSet:
    """A sub-map with the states it takes.

    Attributes
    ----------
    submap_id : int
    frame : GridFrame
        The rectangle, on the cells of the whole map.
    varying : (rows, cols) bool
        Cells whose value differs between states.
    patches : tuple of Patch
    stay_probability : float
        Probability that the state is the same one minute later.
    """

    submap_id: int
    frame: GridFrame
    varying: B1
    patches: tuple[Patch, ...]
    stay_probability: float


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
        "" or why there is no patch: "saw too little", "mixed", "fits no state".
    """

    submap_id: int
    sequence: int
    recording: str
    start_ns: int
    end_ns: int
    patch: int | None
    membership: float
    remark: str = ""
