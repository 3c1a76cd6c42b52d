"""What a person ought to know of a restore as a whole before any row of it is written. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from app.sets.effects import warning_of
from app.sets.model import UnitRows
from app.sets.order import Write
from bus.catalogue.numbers import FOLLOWER_MODE
from bus.catalogue.parameters import PARAMETERS
from bus.messages import Message

RUNS = Message("restore_runs")
MAY_RUN = Message("restore_may_run")


def remarks(
    wanted: UnitRows, present: UnitRows, *, running: bool | None, writes: Iterable[Write]
) -> list[Message]:
    """Whether the machine runs, whose set it is, and of what kind. ``running``: the Run input of the unit,
    None where not known."""
    return [*_motion(running, writes), *_origin(wanted, present), *_kind(wanted, present)]


def _motion(running: bool | None, writes: Iterable[Write]) -> list[Message]:
    if not any(warning_of(write.number, write.wanted, running=running) for write in writes):
        return []
    return [] if running is False else [MAY_RUN if running is None else RUNS]


def _origin(wanted: UnitRows, present: UnitRows) -> list[Message]:
    if wanted.unit == present.unit:
        return []
    return [Message.of("restore_of_other_unit", unit=wanted.unit, present=present.unit)]


def _kind(wanted: UnitRows, present: UnitRows) -> list[Message]:
    found: list[Message] = []
    kinds = [rows.raw(FOLLOWER_MODE) for rows in (wanted, present)]
    if None not in kinds and (kinds[0] == 0) != (kinds[1] == 0):
        found.append(Message("restore_of_master" if kinds[0] == 0 else "restore_of_follower"))
    for rows, code in ((wanted, "restore_source_lacks"), (present, "restore_unit_lacks")):
        lacks = sum(not row.available for row in rows.rows.values())
        if lacks:
            found.append(Message(code, {"count": len(rows.rows) - lacks, "all": len(PARAMETERS)}))
    return found
