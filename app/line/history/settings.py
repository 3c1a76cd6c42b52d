"""``[history]`` of lineside.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bus.settings import StrictModel


class HistorySettings(StrictModel):
    """How long readings are kept."""

    raw_days: Annotated[int, Field(strict=True, ge=1, le=3650)] = 30
    """Every reading itself; after that one-minute and one-hour least, greatest and average."""
    years: Annotated[int, Field(strict=True, ge=1, le=100)] = 10
    """How long minutes and hours are kept, and the bits as intervals."""
