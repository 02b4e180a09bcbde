"""Settings of room 4."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ClusteringSettings(BaseModel):
    """How the states of each sub-map are learned."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    sequence_s: float = Field(
        30.0, ge=0.5, le=3600.0, description="A new observation sequence starts after this time, seconds."
    )
    near_m: float = Field(
        2.0, ge=0, le=30.0, description="The robot is in a sub-map within this distance of it, metres."
    )
    gap_s: float = Field(
        2.0,
        ge=0,
        le=60.0,
        description="Leaving a sub-map for less than this does not end a sequence, seconds.",
    )
    min_scans: int = Field(8, ge=1, le=1000, description="A sequence of fewer scans is left out.")
    min_known_share: float = Field(
        0.3, ge=0.0, le=1.0, description="A visit that knows less of the varying cells founds no state."
    )
    max_states: int = Field(12, ge=1, le=64, description="No sub-map gets more states than this.")
    static_prior: float = Field(
        0.95,
        gt=0.5,
        lt=1.0,
        description="Prior p(c) of the EM that makes the local map of a visit (Eq. 1.10).",
    )
    max_range_m: float = Field(
        12.0, gt=0.5, le=100.0, description="Beams are used up to this range; beyond, poses and spots blur."
    )
    min_crossing_deg: float = Field(
        20.0, ge=0.0, lt=90.0, description="A beam that meets a surface flatter than this says nothing of it."
    )
    min_cells: int = Field(6, ge=1, le=10_000, description="A change of fewer cells is no change.")
