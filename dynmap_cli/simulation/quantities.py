"""What scenarios are made of: numbers within the bounds of what a robot can meet, and frozen parts."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]
Point = tuple[Coordinate, Coordinate]
Degrees = Annotated[float, Field(ge=-3600.0, le=3600.0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Length = Annotated[float, Field(ge=0.001, le=1e4)]
Seconds = Annotated[float, Field(ge=0.0, le=1e8)]
Mean = Annotated[float, Field(ge=0.01, le=1e8)]
Speed = Annotated[float, Field(ge=0.01, le=100.0)]
Rate = Annotated[float, Field(ge=0.01, le=1000.0)]
Scale = Annotated[float, Field(ge=0.01, le=100.0)]
Spread = Annotated[float, Field(ge=0.0, le=1e4)]


class Part(BaseModel):
    """What all parts of a scenario have in common: frozen, no unknown keys, finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
