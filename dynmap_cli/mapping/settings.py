"""Settings of room 2."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class MapSettings(BaseModel):
    """How poses, map and moving beams are estimated."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    resolution_m: float = Field(0.05, gt=0.005, le=1.0, description="Edge of a map cell, metres.")
    poses: Literal["estimate", "recorded"] = Field(
        "estimate", description="Estimate the path, or take the recorded odometry as the true path."
    )
    static_prior: float = Field(
        0.95, gt=0.5, lt=1.0, description="Prior p(c) that a beam hit something static (Eq. 1.10)."
    )
    support_cells: int = Field(
        1,
        ge=0,
        le=3,
        description="Cells around the end cell that may support it; 0 = the paper to the letter.",
    )
    em: Literal["closed", "iterative"] = Field(
        "closed",
        description="Fixed point of the EM at fixed poses in closed form, or by iterated E- and M-steps.",
    )
    stop_at_walls: bool = Field(
        True,
        description="A beam without return passes only up to the first wall others see; in the paper it passes on.",
    )
    look_s: float = Field(
        5.0, ge=0.0, le=600.0, description="Scans of this many seconds are one look at a place; 0 = no looks."
    )
    look_prior: float = Field(
        0.8,
        gt=0.5,
        lt=1.0,
        description="Dynamic is also what fewer than 2 (1 - prior) of the looks at its place saw there.",
    )
    max_rounds: int = Field(2, ge=1, le=20, description="Rounds of registration and filtering at most.")
    stop_label_share: float = Field(
        0.001, ge=0.0, le=1.0, description="Stop when fewer labels than this share change in a round."
    )
    usable_range_m: float = Field(
        30.0,
        gt=0.5,
        le=1000.0,
        description="Beams are used up to this range; a beam without return is free up to it.",
    )
