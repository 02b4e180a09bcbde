"""Settings of room 5."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class LocalizationSettings(BaseModel):
    """How pose and state of the world are tracked."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    min_particles: int = Field(500, ge=10, description="Particles at least.")
    max_particles: int = Field(3000, ge=10, description="Particles at most.")
