"""What a spare is made from, as chosen: a stored set, a neighbor as it is now, a file, or the sheet."""

from __future__ import annotations

from collections.abc import Callable

from app.errors import Problem
from app.live.state.bus_live import LiveState
from app.sets.form_source import FormSource
from app.sets.keeper import SetKeeper
from app.sets.sides import side
from app.sets.store import SetStore
from app.swap.record import SwapSource
from app.web.access import Person
from bus.messages import Message

SHEET = "sheet"
"""Nothing is stored: a person enters the values."""


async def source_of(
    person: Person,
    keepers: Callable[[str], SetKeeper],
    sets: SetStore,
    live: LiveState,
    bus: str,
    unit: int,
    form: FormSource,
) -> SwapSource | None:
    """What the form chooses, as a stored set: a neighbor is read now, a file is kept. None: the sheet.

    ``keepers``: by bus. Raises Problem 404, 422 or 504.
    """
    if rows := await form.uploaded(unit):
        kept = await keepers(bus).keep(person, [rows], form.file_name[:80], "", "from a file")
        return SwapSource(kept.id, rows.unit)
    if form.text == SHEET:
        return None
    if not form.text:
        raise Problem(422, "invalid", Message("spare_not_chosen"))
    chosen = await side(form.text, sets, live)
    if chosen.kind == "set":
        return SwapSource(int(chosen.of), chosen.unit)
    kept = await keepers(chosen.of).take(person, [chosen.unit], "", "", "for a unit swap")
    return SwapSource(kept.id, chosen.unit)
