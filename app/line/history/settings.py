"""``[history]`` of lineside.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bus.settings import StrictModel


class HistorySettings(StrictModel):
    """The retention of readings."""

    raw_days: Annotated[int, Field(strict=True, ge=1, le=3650)] = 30
    """How long every reading is kept; older ones are one-minute and one-hour least, greatest and average."""
    years: Annotated[int, Field(strict=True, ge=1, le=100)] = 10
    """How long minutes and hours are kept, and the bits as intervals."""
