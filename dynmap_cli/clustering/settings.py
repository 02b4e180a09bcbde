"""Settings of room 4."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class ClusteringSettings(BaseModel):
    """How the states of each sub-map are learned."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    sequence_s: float = Field(
        30.0, gt=0, description="A new observation sequence starts after this time, seconds."
    )
    near_m: float = Field(
        2.0, ge=0, description="The robot is in a sub-map within this distance of it, metres."
    )
