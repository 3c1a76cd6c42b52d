"""``[server.sessions]`` of lineside.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from bus.messages import Message
from bus.settings import StrictModel


class Sessions(StrictModel):
    """How long a sign-in lasts: since it was last used, and in all."""

    idle_hours: Annotated[float, Field(strict=True, ge=0.25, le=168)] = 12
    """A shift and its overlap."""
    total_days: Annotated[float, Field(strict=True, ge=0.04, le=90)] = 7
    panel_idle_days: Annotated[float, Field(strict=True, ge=0.04, le=365)] = 90
    """A panel on the wall stays signed in."""
    panel_total_days: Annotated[float, Field(strict=True, ge=0.04, le=3650)] = 365

    @model_validator(mode="after")
    def _idle_is_not_longer_than_all(self) -> Sessions:
        if self.idle_hours > 24 * self.total_days:
            raise ValueError(Message("setting_idle_hours"))
        if self.panel_idle_days > self.panel_total_days:
            raise ValueError(Message("setting_panel_idle_days"))
        return self
