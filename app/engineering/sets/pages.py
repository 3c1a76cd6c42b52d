"""The pages of parameter sets: the list, one set, a comparison, the drift of a unit, and a restore (choose a
set, review each row, follow the writes, read the result)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Form, Query, Request, Response
from starlette.responses import RedirectResponse

from app.core.web.access import Person, Viewer
from app.core.web.problems import is_fragment
from app.core.web.routes import GuardedRoute
from app.core.web.services import bus_service_of, service
from app.core.web.shape import UnitAddresses
from app.core.web.templating import render
from app.engineering.sets.api import Drift
from app.engineering.sets.drift import BusDrift
from app.engineering.sets.lookup import (
    FILE_FORM,
    Chosen,
    KnownRestore,
    Restores,
    Sets,
    StoredSet,
    choices,
    offers,
    side,
)
from app.engineering.sets.model import compare, row_message
from app.engineering.sets.restore_api import Planner, rows_left_out, rows_to_write
from app.engineering.sets.restore_plan import Restore, Selection
from app.engineering.sets.restore_service import CANCEL, START, RestoreService
from app.engineering.sets.saving import MARK_GOLDEN, SAVE, SCHEDULE, SetKeeper, SetReadings, SetSchedule
from app.engineering.sets.store import SetStore
from app.errors import Problem, or_404
from app.line.commands.effects import OPERATING_VALUES
from app.line.commands.page_context import PageContext
from app.line.commands.review import by_remark
from app.line.live.api.routes import Live
from app.line.live.bus_live import LiveState, unit_link_now
from app.line.live.diagnosis import no_response_text, unit_cause
from app.line.live.fields import STATE_WORDS, cause_texts, joined
from app.line.live.requests import bus_or_404, unit_or_404
from bus.catalogue.parameters import PARAMETERS
from bus.instants import unix_now
from bus.messages import Message
from bus.validation import Lines, OneLine, TypedText

router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
Readings = Annotated[SetReadings, service(SetReadings)]

DIFFERENT = ("differs", "unavailable")
_TIME_OF_DAY = re.compile(r"([01]?[0-9]|2[0-3]):([0-5][0-9])")
MAX_SEARCHED = 80
MAX_LISTED = 100
"""The sets on one page of the list; a schedule adds some every day."""


@router.get("/sets")
async def list_page(
    request: Request,
    _: Viewer,
    sets: Sets,
    live: Live,
    bus: str = "",
    unit: int | None = None,
    before: int | None = None,
    search: Annotated[TypedText, Query(max_length=MAX_SEARCHED)] = "",
    saved: str = "",
) -> Response:
    """List the newest sets, or those before one, by bus, unit and text, with the forms that save a set.
    ``saved``: the bus whose schedule was just saved."""
    return await _list(request, sets, live, bus, unit, before, search.strip(), saved=saved)


async def _list(
    request: Request,
    sets: SetStore,
    live: LiveState,
    bus: str = "",
    unit: int | None = None,
    before: int | None = None,
    typed: str = "",
    *,
    saved: str = "",
    refused: str = "",
    typed_at: str = "",
) -> Response:
    """Show the list of sets; ``refused``: the bus whose schedule does not take the time ``typed_at``."""
    found = await sets.summaries(bus or None, unit, before=before, text=typed, limit=MAX_LISTED + 1)
    return render(
        request,
        "sets/page.html",
        status=422 if refused else 200,
        saved=saved,
        refused=refused,
        typed_at=typed_at,
        buses=live.buses,
        faults={name: no_response_text(of_bus, unix_now()) for name, of_bus in live.buses.items()},
        sets=found[:MAX_LISTED],
        ranges=partial(_ranges, live),
        older=found[MAX_LISTED - 1].id if len(found) > MAX_LISTED else None,
        schedule=await sets.schedule(),
        overdue={name: bus_service_of(request, name, SetSchedule).overdue() for name in live.buses},
        bus=bus,
        unit=unit,
        typed=typed,
    )


def _ranges(live: LiveState, bus: str, units: Iterable[int]) -> str:
    """Name the units of a set by their present names."""
    known = live.buses[bus].settings.unit if bus in live.buses else []
    return ", ".join(unit_ranges(units, {unit.id: unit.name for unit in known}))


@router.post("/sets/take")
async def begin_reading(
    request: Request,
    person: Annotated[Person, SAVE.permitted],
    live: Live,
    readings: Readings,
    bus: Annotated[str, Form()],
    unit: Annotated[UnitAddresses | None, Form()] = None,
    name: Annotated[OneLine, Form(max_length=80)] = "",
    comment: Annotated[Lines, Form(max_length=1000)] = "",
    golden: Annotated[bool, Form()] = False,
) -> Response:
    """Begin to read the chosen units, or all units of the bus if none is chosen."""
    units = unit or list(bus_or_404(live, bus).units)
    for number in units:
        unit_or_404(live, bus, number)
    keeper = bus_service_of(request, bus, SetKeeper)
    taking = readings.begin(person, keeper, units, name, comment, golden=golden)
    path = f"/sets/taking/{taking.id}"
    return Response(headers={"HX-Redirect": path}) if is_fragment(request) else RedirectResponse(path, 303)


@router.get("/sets/golden")
async def review_golden(
    request: Request, _: Annotated[Person, MARK_GOLDEN.permitted], sets: Sets, live: Live, bus: str
) -> Response:
    """Show before golden sets of a bus are saved which units are read, what each set replaces, which units do
    not run at speed, and which are left out."""
    of_bus, now, translator = bus_or_404(live, bus), unix_now(), PageContext(request).translator
    units, doubts, left_out = [], [], []
    for unit in of_bus.units.values():
        cause, name = unit_cause(of_bus, unit, now), unit.settings.name
        why = cause_texts(cause, translator, now).line if cause else ""
        if unit_link_now(of_bus, unit, now) in ("unknown", "offline"):
            left_out.append((name, Message.of("golden_not_read", why=why)))
            continue
        units.append(unit)
        if unit.motion.state != "at_speed":
            state = why or joined(translator.t(STATE_WORDS[unit.motion.state]))
            doubts.append((name, Message.of("golden_not_at_speed", state=state)))
    return render(
        request,
        "sets/_golden_review.html",
        bus=bus,
        units=units,
        doubts=by_remark(doubts),
        left_out=by_remark(left_out),
        marked={unit: one for one in await sets.summaries(bus) for unit in one.golden_for},
        drift=bus_service_of(request, bus, BusDrift),
    )


@router.get("/sets/taking/{taking_id}")
async def taking_page(
    request: Request, _: Viewer, readings: Readings, live: Live, taking_id: str
) -> Response:
    """Show the number of values read so far, and the result of each unit."""
    taking = or_404(readings.get(taking_id), "unknown_taking", Message("no_such_taking"))
    return render(
        request,
        "sets/_taking.html" if request.headers.get("hx-request") else "sets/taking.html",
        taking=taking,
        values_read=taking.values_read(bus_service_of(request, taking.bus, SetKeeper)),
        units=live.buses[taking.bus].units,
        PARAMETERS=PARAMETERS,
    )


@router.post("/sets/schedule")
async def set_schedule(
    request: Request,
    person: Annotated[Person, SCHEDULE.permitted],
    sets: Sets,
    live: Live,
    bus: Annotated[str, Form()],
    at: Annotated[OneLine, Form(max_length=20)] = "",
) -> Response:
    """Save a bus daily at a time of the day; an empty time ends this."""
    schedule, typed = bus_service_of(request, bus, SetSchedule), _TIME_OF_DAY.fullmatch(at.strip())
    if typed is None and at.strip():
        return await _list(request, sets, live, refused=bus, typed_at=at)
    await schedule.set(person, int(typed[1]) * 60 + int(typed[2]) if typed else None)
    return RedirectResponse("/sets?" + urlencode({"saved": bus}), 303)


@router.get("/sets/compare")
async def compare_page(
    request: Request,
    _: Viewer,
    sets: Sets,
    live: Live,
    left: str = "",
    right: str = "",
    tolerance: int = 0,
    everything: bool = False,
) -> Response:
    """Compare two sides row by row, equal rows only on request, and offer the sides."""
    left = left or _golden_beside(request, live, right)
    one = await side(left, sets, live) if left else None
    other = await side(right, sets, live) if right else None
    rows = compare(one.rows, other.rows, max(0, tolerance)) if one and other else []
    operating = [row for row in rows if row.number in OPERATING_VALUES and row.kind in DIFFERENT]
    read_sides = [each for each in (one, other) if one and other and each and each.kind == "live"]
    read = [row.read_at for each in read_sides for row in each.rows.rows.values() if row.read_at is not None]
    return render(
        request,
        "sets/compare.html",
        left=left,
        right=right,
        one=one,
        other=other,
        read_sides=read_sides,
        read_at=min(read, default=None),
        choices=choices(live, await sets.summaries()),
        tolerance=tolerance,
        everything=everything,
        differing=[row for row in rows if row.kind in DIFFERENT and row not in operating],
        operating=operating,
        unknown=[row for row in rows if row.kind == "unknown" and not PARAMETERS[row.number].secret],
        password_compared=not any(row.kind == "unknown" and PARAMETERS[row.number].secret for row in rows),
        equal=[row for row in rows if row.kind == "equal"],
    )


def _golden_beside(request: Request, live: LiveState, right: str) -> str:
    """Return the golden set of the unit that ``right`` names; empty if it has none."""
    kind, _, place = right.partition(":")
    bus, _, unit = place.rpartition(":")
    if kind != "live" or bus not in live.buses or not unit.isdecimal():
        return ""
    return f"golden:{place}" if bus_service_of(request, bus, BusDrift).has_golden(int(unit)) else ""


@router.get("/sets/{set_id}")
async def one_page(request: Request, _: Viewer, sets: Sets, live: Live, stored: StoredSet) -> Response:
    """Show a stored set, each value with the frame that proves it."""
    others = await sets.summaries(stored.bus)
    return render(
        request,
        "sets/one.html",
        stored=stored,
        row_message=row_message,
        PARAMETERS=PARAMETERS,
        others=[summary for summary in others if summary.id != stored.id],
        configured=live.buses[stored.bus].units if stored.bus in live.buses else {},
    )


@router.post("/sets/{set_id}/golden")
async def golden(
    request: Request,
    person: Annotated[Person, MARK_GOLDEN.permitted],
    stored: StoredSet,
    unit: Annotated[int, Form()],
) -> Response:
    """Make the stored set the golden set of a unit."""
    await bus_service_of(request, stored.bus, SetKeeper).mark_golden(person, stored, [unit])
    return RedirectResponse(f"/sets/{stored.id}", 303)


@router.get("/units/{bus}/{unit}/drift")
async def drift_fragment(
    request: Request, _: Viewer, drift: Drift, sets: Sets, live: Live, bus: str, unit: int
) -> Response:
    """Show the parameters in which the unit differs from its golden set, and who changed them."""
    unit_or_404(live, bus, unit)
    marked = (one for one in await sets.summaries(bus, unit) if unit in one.golden_for)
    return render(
        request,
        "sets/_drift.html",
        bus=bus,
        unit=unit,
        golden=next(marked, None) if drift.has_golden(unit) else None,
        departures=await drift.traced(unit),
        unread=drift.unread(unit),
        PARAMETERS=PARAMETERS,
    )


_TO = "\N{EN DASH}"


def unit_ranges(units: Iterable[int], names: Mapping[int, str]) -> list[str]:
    """Name units by ranges with en dashes, as in ``["1 Unwind", "4-11 Dryer 1-8"]``; a removed unit only has
    its address."""
    return [_range_text(first, last, names) for first, last in _runs(sorted(units))]


def _runs(units: list[int]) -> Iterator[tuple[int, int]]:
    """Return the first and the last address of each run of addresses."""
    starts = [unit for at, unit in enumerate(units) if at == 0 or units[at - 1] != unit - 1]
    ends = [unit for at, unit in enumerate(units) if at == len(units) - 1 or units[at + 1] != unit + 1]
    return zip(starts, ends, strict=True)


def _range_text(first: int, last: int, names: Mapping[int, str]) -> str:
    begin, end = names.get(first, ""), names.get(last, "")
    if first == last:
        return f"{first} {begin}".strip()
    return f"{first}{_TO}{last} {_joined(begin, end, last - first)}".strip()


def _joined(begin: str, end: str, apart: int) -> str:
    """Join two names; say the words once if their numbers are as far ``apart`` as the addresses."""
    if not begin or not end:
        return ""
    (word, _, low), (other, _, high) = begin.rpartition(" "), end.rpartition(" ")
    numbered = word == other and low.isdecimal() and high.isdecimal() and int(high) - int(low) == apart
    return f"{begin}{_TO}{high}" if numbered else f"{begin} {_TO} {end}"


Ticks = Annotated[list[int] | None, Form()]


@router.get("/units/{bus}/{unit}/restore")
async def restore_page(
    request: Request, _: Planner, sets: Sets, restores: Restores, live: Live, bus: str, unit: int
) -> Response:
    """Offer the sets from which the unit can be restored, and its earlier restores."""
    live_unit = unit_or_404(live, bus, unit)
    return render(
        request,
        "sets/restore.html",
        bus=bus,
        unit=live_unit,
        offers=offers(live, await sets.summaries(), bus, unit),
        earlier=await restores.of_unit(bus, unit),
    )


@router.post("/units/{bus}/{unit}/restore", **FILE_FORM)
async def plan_page(
    person: Planner, sets: Sets, restores: Restores, live: Live, bus: str, unit: int, chosen: Chosen
) -> Response:
    """Read the unit and plan a restore; nothing is written."""
    unit_or_404(live, bus, unit)
    rows = await chosen.uploaded(unit)
    if rows is None:
        if not chosen.text.startswith(("set:", "golden:")):
            raise Problem(422, "invalid", Message("set_or_file_missing"))
        rows = (await side(chosen.text, sets, live)).rows
    restore = await restores.plan(person, bus, unit, rows)
    return RedirectResponse(f"/restores/{restore.id}", 303)


@router.get("/restores/{restore_id}")
async def restore_progress(request: Request, _: Planner, restore: KnownRestore) -> Response:
    """Show the review before the start, then the progress, then the result."""
    template = "sets/_restore.html" if request.headers.get("hx-request") else "sets/restoring.html"
    dangerous = {left.number for left in restore.left_out if PARAMETERS[left.number].dangerous}
    response = render(
        request,
        template,
        restore=restore,
        rows=rows_to_write(restore),
        left_out=rows_left_out(restore),
        tickable=dangerous,
        proven=compare(restore.wanted, restore.proven) if restore.proven else [],
        PARAMETERS=PARAMETERS,
    )
    if restore.state != "running":
        # The state, and with it the buttons, have changed: render the complete part.
        response.headers["HX-Retarget"] = response.headers["HX-Reselect"] = "#restore"
    return response


@router.post("/restores/{restore_id}/tick")
async def confirm_dangerous(
    person: Planner, restores: Restores, live: Live, old: KnownRestore, tick: Ticks = None
) -> Response:
    """Plan again with dangerous rows that a person has confirmed one by one."""
    selection = Selection(confirmed=old.selection.confirmed | frozenset(tick or ()))
    return await _planned_again(person, restores, live, old, selection)


@router.post("/restores/{restore_id}/again")
async def plan_again(person: Planner, restores: Restores, live: Live, old: KnownRestore) -> Response:
    """Plan a restore again: rows that were written are equal now, the rest is reviewed."""
    deselected = frozenset(left.number for left in old.left_out if left.reason == "deselected")
    return await _planned_again(person, restores, live, old, Selection(exclude=deselected))


async def _planned_again(
    person: Person, restores: RestoreService, live: LiveState, old: Restore, selection: Selection
) -> Response:
    unit_or_404(live, old.bus, old.unit)
    fresh = await restores.plan(person, old.bus, old.unit, old.wanted, selection, for_swap=old.for_swap)
    return RedirectResponse(f"/restores/{fresh.id}", 303)


@router.post("/restores/{restore_id}/start")
async def start(
    person: Annotated[Person, START.permitted], restores: Restores, restore: KnownRestore, row: Ticks = None
) -> Response:
    """Write the ticked rows of a restore."""
    # A spare to which nothing is to be written is only read.
    if row or restore.rows or not restore.for_swap:
        restores.select(person, restore, ticked(restore, frozenset(row or ())))
    restores.start(person, restore)
    return RedirectResponse(f"/restores/{restore.id}", 303)


@router.post("/restores/{restore_id}/cancel")
async def cancel(
    person: Annotated[Person, CANCEL.permitted], restores: Restores, restore: KnownRestore
) -> Response:
    """Stop a restore after its current row."""
    restores.cancel(person, restore)
    return RedirectResponse(f"/restores/{restore.id}", 303)


def ticked(restore: Restore, rows: frozenset[int]) -> Selection:
    """Return the selection that a person made in a review. Raise Problem 422 for no row, and for a row that
    the review did not have."""
    reviewed = frozenset(write.number for write in restore.plan.writes)
    reviewed |= frozenset(write.number for write, _ in restore.offered)
    if not rows:
        raise Problem(422, "invalid", Message("no_row_chosen"))
    if rows - reviewed:
        raise Problem(422, "invalid", Message("not_what_was_reviewed"))
    return restore.selection.choosing(rows, reviewed - rows - OPERATING_VALUES)
