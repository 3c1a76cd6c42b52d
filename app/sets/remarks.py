"""What a person ought to know of a restore as a whole before any row of it is written. Pure."""

from __future__ import annotations

from collections.abc import Iterable

from app.sets.effects import warning_of
from app.sets.model import UnitRows
from app.sets.order import Write
from bus.catalogue.numbers import FOLLOWER_MODE
from bus.catalogue.parameters import PARAMETERS

RUNS = "the unit runs: the marked rows change the speed of the machine immediately"
MAY_RUN = (
    "whether the unit runs is not known: the marked rows may change the speed of the machine immediately"
)


def remarks(
    wanted: UnitRows, present: UnitRows, *, running: bool | None, writes: Iterable[Write]
) -> list[str]:
    """Whether the machine runs, whose set it is, and of what kind. ``running``: the Run input of the unit,
    None where not known."""
    return [*_motion(running, writes), *_origin(wanted, present), *_kind(wanted, present)]


def _motion(running: bool | None, writes: Iterable[Write]) -> list[str]:
    if not any(warning_of(write.number, write.wanted, running=running) for write in writes):
        return []
    return [] if running is False else [MAY_RUN if running is None else RUNS]


def _origin(wanted: UnitRows, present: UnitRows) -> list[str]:
    if wanted.unit == present.unit:
        return []
    return [f"the set is of unit {wanted.unit}, this is unit {present.unit}: read every row"]


def _kind(wanted: UnitRows, present: UnitRows) -> list[str]:
    found: list[str] = []
    kinds = [rows.raw(FOLLOWER_MODE) for rows in (wanted, present)]
    if None not in kinds and (kinds[0] == 0) != (kinds[1] == 0):
        found.append(
            "the set is from a master, this unit is a follower (#8): another type of section"
            if kinds[0] == 0
            else "the set is from a follower, this unit is a master (#8): another type of section"
        )
    for rows, text in ((wanted, "the unit of the set"), (present, "this unit")):
        lacks = sum(not row.available for row in rows.rows.values())
        if lacks:
            found.append(f"{text} has {len(rows.rows) - lacks} of {len(PARAMETERS)} parameters only")
    return found
