"""What every body and every instant of the API looks like."""

from __future__ import annotations

from datetime import UTC, datetime

from pydantic import BaseModel, ConfigDict


class Strict(BaseModel):
    """A body in which nothing is unknown, nothing is converted and no number is infinite."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def iso(at: float) -> str:
    """An instant, seconds since the epoch, as the API writes it: ISO 8601, UTC, milliseconds."""
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds")
