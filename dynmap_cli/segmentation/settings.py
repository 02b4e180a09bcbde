"""Settings of room 3."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class SegmentationSettings(BaseModel):
    """How areas that change are found."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    window_s: float = Field(30.0, gt=0, description="Length of the time windows that are compared, seconds.")
    max_area_m2: float = Field(20.0, gt=0, description="No sub-map is larger than this, square metres.")
