"""Settings of room 3."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class SegmentationSettings(BaseModel):
    """How areas that change are found."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    window_s: float = Field(
        30.0, ge=0.5, le=3600.0, description="Length of the time windows that are compared, seconds."
    )
    max_area_m2: float = Field(
        20.0, ge=1.0, le=1000.0, description="No sub-map is larger than this, square metres."
    )
    max_range_m: float = Field(
        12.0,
        gt=0.5,
        le=100.0,
        description="Beams are evidence up to this range; beyond, poses and spots blur.",
    )
    min_crossing_deg: float = Field(
        20.0, ge=0.0, lt=90.0, description="A beam that meets a surface flatter than this says nothing of it."
    )
    support_cells: int = Field(
        1,
        ge=0,
        le=3,
        description="Cells around a free one that must be free too; 2 if poses are off by 3 cm.",
    )
    growth_cells: int = Field(
        3, ge=0, le=20, description="Contested cells up to twice this far apart belong to one region."
    )
    min_cells: int = Field(6, ge=1, le=10_000, description="A region has at least so many contested cells.")
    merge: Literal["visible", "dependent"] = Field(
        "visible",
        description="Merge regions that see one another, or of these only those that change together: smaller, more.",
    )
    margin_m: float = Field(
        0.2, ge=0.0, le=5.0, description="Border of a sub-map around its contested cells."
    )


def margin_cells(settings: SegmentationSettings, resolution_m: float) -> int:
    """Border of a rectangle around its contested cells."""
    return math.ceil(settings.margin_m / resolution_m - 1e-9)
