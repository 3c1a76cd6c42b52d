"""What a spare is made from, as chosen: a stored set, a neighbor as it is now, a file, or the sheet."""

from __future__ import annotations

from fastapi import UploadFile

from app.errors import Problem
from app.live.state import LiveState
from app.sets.keeper import SetKeeper
from app.sets.lookup import uploaded_rows
from app.sets.sides import side
from app.swap.record import Source
from app.web.access import Person

SHEET = "sheet"
"""Nothing is stored: a person enters the values."""


async def source_of(
    person: Person,
    keeper: SetKeeper,
    live: LiveState,
    bus: str,
    unit: int,
    text: str,
    file: UploadFile | None,
) -> Source | None:
    """What was chosen, as a stored set: a neighbour is read now, a file is kept. None: the sheet.

    Raises Problem 404, 422 or 504 in words.
    """
    if file is not None and file.filename:
        rows = await uploaded_rows(unit, file)
        kept = await keeper.keep(person, bus, [rows], file.filename[:80], "", "from a file")
        return Source(kept.id, rows.unit)
    if text == SHEET:
        return None
    if not text:
        raise Problem(422, "invalid", "choose what the spare shall become; nothing was begun")
    chosen = await side(text, keeper, live)
    if chosen.kind == "set":
        return Source(int(chosen.of), chosen.unit)
    name = f"for the swap of unit {unit}"
    return Source((await keeper.take(person, chosen.of, [chosen.unit], name, "")).id, chosen.unit)
