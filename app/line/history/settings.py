"""The table ``[history]`` of lineside.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bus.settings import StrictModel


class HistorySettings(StrictModel):
    """The retention of readings."""

    raw_days: Annotated[int, Field(strict=True, ge=1, le=3650)] = 30
    """The days that every reading is kept, then only least, greatest and average of minutes and hours."""
    years: Annotated[int, Field(strict=True, ge=1, le=100)] = 10
    """The years for which minutes and hours are kept, and the bits as intervals."""
