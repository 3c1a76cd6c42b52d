"""The settings of shifts: ``[shift]`` of lineside.toml."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from app.records.notification.settings import ClockTime, minute_of_day
from bus.messages import Message
from bus.settings import StrictModel


class ShiftSettings(StrictModel):
    """The start times of the site's shifts, and the space for pictures."""

    starts: Annotated[tuple[ClockTime, ...], Field(min_length=1, max_length=24)] = ("06:00", "14:00", "22:00")
    """The local times at which shifts start; a shift lasts until the next start."""
    pictures_mb: Annotated[int, Field(ge=0, le=1_000_000)] = 2_000
    """The most space for the pictures of all notes, in MB."""

    @property
    def minutes(self) -> list[int]:
        """The starts as minutes after local midnight."""
        return [minute_of_day(each) for each in self.starts]

    @field_validator("starts")
    @classmethod
    def _each_once(cls, starts: tuple[str, ...]) -> tuple[str, ...]:
        for index, start in enumerate(starts):
            if start in starts[:index]:
                raise ValueError(Message.of("setting_shift_twice", time=start))
        return starts
