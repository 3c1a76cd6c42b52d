"""When a recipe ran: from when it was loaded until the next one was, as the event log has it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Annotated

from pydantic import Field
from typing_extensions import TypedDict

from app.core.web.api.shape import Instant, MaybeInstant, iso
from app.people.audit.entry import Event

MAX_LOADS = 1000
"""Loads of recipes that are searched for an earlier run."""


class RecipeRuns(TypedDict):
    """The run of a recipe at a time, and the one of the same recipe before it."""

    name: str
    loaded: Annotated[Instant, Field(description="When it was loaded, ISO 8601.")]
    before: Annotated[MaybeInstant, Field(description="When its run before began; null: it had none.")]


def runs_of(loads: Sequence[Event]) -> RecipeRuns | None:
    """The run that the newest of these loads is in, and the one of the same recipe before it. ``loads``:
    newest first; a recipe that was loaded again while it ran is one run. None where none was loaded."""
    runs = [
        (name, min(load["time"] for load in run))
        for name, run in groupby(loads, lambda load: str(load["messages"]["what"].params["name"]))
    ]
    if not runs:
        return None
    name, loaded = runs[0]
    before = next((start for earlier, start in runs[1:] if earlier == name), None)
    return {"name": name, "loaded": iso(loaded), "before": None if before is None else iso(before)}
