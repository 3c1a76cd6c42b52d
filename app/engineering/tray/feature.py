"""The feature of the change tray: the tray of a request's person, and its pages: adding a change next to each
way of setting a value, the review, sending, the results."""

from __future__ import annotations

import asyncio
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from fastapi import APIRouter, Form
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response

from app.core.database import Database
from app.core.find.finders import Finders, FixedPlace
from app.core.messages import Language
from app.core.web.access import Caller, Person
from app.core.web.arrival import Deadline
from app.core.web.routes import GuardedRoute
from app.core.web.services import bus_service_of
from app.core.web.templating import Templates
from app.engineering.recipes.api import KnownRecipe
from app.engineering.recipes.rules import why_not_setpoint
from app.engineering.sets.batch import refused_batch, rows_of_batch, typed_batch, writable_or_404
from app.engineering.sets.lookup import KnownRestore, Restores
from app.engineering.sets.pages import Ticks, ticked
from app.engineering.tray.contents import (
    ON_OFF,
    PlaceScales,
    TrayRow,
    Trays,
    place_of,
    setpoint_row,
    steps_of,
    unable_units,
    value_row,
)
from app.engineering.tray.store import TrayStore
from app.errors import Problem
from app.feature import Feature, Services
from app.line.commands.catalogue import (
    SET_LINE,
    SET_SPEED,
    WRITE_ANALOG_OUTPUT,
    WRITE_OUTPUT,
    kind_of_command,
    longest_change_s,
    timeout_s_for,
)
from app.line.commands.control import controlled
from app.line.commands.page_context import BusPage, Confirmed, Page, PageOfBus, PageOfUnit, ReviewedScale
from app.line.commands.pages.line import followers_of, left_out_of, refuse_outsiders, typed_setpoints
from app.line.commands.pages.speed import explain_setpoint
from app.line.commands.pages.unit import CONFIRMING_WORD, OutputPath, ParameterPath, typed_analog
from app.line.commands.review import OutcomeText, Tone, by_remark, draw_changes, failed_units, outcome_text
from app.line.commands.rules import reason_of
from app.line.commands.service import CommandService, ParameterWriter, permitted, permitted_writer
from app.line.commands.undo import UndoOffer, ValuePlace, Values, action_for
from app.line.commands.values import (
    Scales,
    differs,
    parameter_message,
    parse_scale,
    scales_of,
    setpoint_message,
)
from app.line.live.bus_live import BusLive
from app.people.audit.log import EventLog
from bus.catalogue.parameters import PARAMETERS
from bus.contract import Result, UnitOutcome, UnitScale
from bus.errors import CallerError
from bus.instants import Monotonic, monotonic_now
from bus.messages import Message, joined, term


class OwnTray:
    """The tray of one person for one bus."""

    def __init__(self, page: BusPage) -> None:
        self.page = page
        self._store = bus_service_of(page.request, page.name, TrayStore)
        self._trays = self._store.trays

    @property
    def changes(self) -> Values:
        """The changes of units that are still configured."""
        held = self._trays.changes(self.page.person.sender, monotonic_now())
        return {place: raw for place, raw in held.items() if place.unit in self.page.bus.units}

    @property
    def scales(self) -> PlaceScales:
        """The scales that showed the changes when they were added."""
        return self._trays.scales(self.page.person.sender)

    async def add(
        self, changes: Values, deadline: Deadline | None = None, scales: Scales | None = None
    ) -> None:
        """Add all changes or none. ``scales``: those that converted them, by unit; None: the present ones.

        Raise Problem for a change that this person could never send.
        """
        deadline = deadline or self.page.deadline()
        given = scales or {}
        shown_with = {
            place: {**scales_of(action_for({place: raw}), self.page.bus), **given}.get(place.unit, {})
            for place, raw in changes.items()
        }
        for place, raw in changes.items():
            if place.kind == "parameter" and place.number in PARAMETERS and PARAMETERS[place.number].secret:
                raise Problem(422, "invalid", Message.of("tray_secret", number=place.number))
            action = action_for({place: raw})
            await self.page.commands.check_for_later(self.page.person, action, deadline)
        self._trays.add(self.page.person.sender, changes, monotonic_now(), shown_with)
        await self._store.save(self.page.person.sender)

    async def remove(self, changes: Values) -> None:
        """Remove changes, except those whose value has changed meanwhile."""
        self._trays.remove(self.page.person.sender, changes)
        await self._store.save(self.page.person.sender)

    def sending(self, changes: Values) -> AbstractAsyncContextManager[None]:
        """Return the context in which changes are sent and removed: no restart shows them as unsent."""
        return self._store.sending(self.page.person.sender, changes)

    def rows(self) -> list[TrayRow]:
        """Check every change against its unit's present state."""
        return tray_rows(self.page, self.changes, self.scales)

    async def learn(self) -> None:
        """Read the parameters that keypads may have changed, and the ramps that were never read, for the
        units that take commands now."""
        places = [place for place in self.changes if self.page.obstacle(place.unit) is None]
        numbers: dict[int, list[int]] = {}
        for place in places:
            if place.kind == "parameter":
                numbers.setdefault(place.unit, []).append(place.number)
        await asyncio.gather(
            self.page.know_ramps(place.unit for place in places if place.kind == "setpoint"),
            self._read(numbers.items()),
        )

    async def _read(self, numbers: Iterable[tuple[int, list[int]]]) -> None:
        deadline = self.page.deadline()
        for unit, those in numbers:
            with suppress(Problem):
                await self.page.commands.read(self.page.person, unit, those, deadline)


def tray_rows(page: BusPage, changes: Values, scales: PlaceScales) -> list[TrayRow]:
    """Check changes against the present state of units, in the order of sending, setpoints in floor order.

    ``scales``: those that showed the changes when they were added.
    """
    floor = {unit: at for at, unit in enumerate(page.bus.units)}
    values, rows = page.commands.undo.values_now(changes), list[TrayRow]()
    for step in steps_of(changes):
        for place, raw in sorted(step.items(), key=lambda change: floor[change[0].unit]):
            refusal = _refusal(page, place, raw, scales.get(place, {}))
            if place.kind == "setpoint":
                change, unit = page.change(place.unit, raw), page.bus.units[place.unit]
                rows.append(setpoint_row(place, raw, change, unit, refusal))
            else:
                rows.append(value_row(place, raw, values[place], page.bus, refusal))
    return rows


def _refusal(page: BusPage, place: ValuePlace, raw: int, added_with: UnitScale) -> Message | None:
    """Return the reason why a change, if confirmed, would be refused now."""
    if (obstacle := page.obstacle(place.unit)) is not None:
        return obstacle
    if differs(added_with, page.bus.units[place.unit]):
        return Message("tray_other_scale")
    try:
        page.check(action_for({place: raw}))
    except Problem as problem:
        return reason_of(problem)
    return None


_DONE = ("verified", "acknowledged")


@dataclass(frozen=True, slots=True)
class TrayResult:
    """The result of one change. ``id``: of its command; ``part``: the result, or why nothing was sent."""

    place: ValuePlace
    raw: int
    id: str
    part: Result | UnitOutcome | Message

    @property
    def is_done(self) -> bool:
        """Whether the unit has taken the change, which then leaves the tray."""
        return not isinstance(self.part, Message) and self.part.outcome in _DONE


def first_id(id: str) -> str:
    """Return the id of the first command of a tray that is sent with the id ``id``."""
    return f"{id}-0"


async def send_changes(
    commands: CommandService,
    person: Person,
    bus: BusLive,
    changes: Values,
    id: str,
    made_at: Monotonic,
    scales: PlaceScales,
) -> list[TrayResult]:
    """Send changes: all setpoints as one command, then the rest one by one, until one fails.

    Return the result of each in that order. ``id``: of the form; sending it again gives the same results.
    ``made_at``: the time when the person confirmed, where the deadline of the first command starts.
    ``scales``: those that showed the changes.
    """
    results: list[TrayResult] = []
    failed = False
    for step, values in enumerate(steps_of(changes)):
        key = f"{id}-{step}"
        if failed:
            parts: dict[ValuePlace, Result | UnitOutcome | Message] = dict.fromkeys(
                values, Message("tray_stopped_before")
            )
        else:
            deadline = _deadline(bus, values, made_at) if step == 0 else None
            shown_with = {place.unit: scales.get(place, {}) for place in values}
            parts = await _sent(commands, person, values, key, deadline, shown_with)
        these = [TrayResult(place, values[place], key, part) for place, part in parts.items()]
        failed = failed or not all(result.is_done for result in these)
        results += these
    return results


def _deadline(bus: BusLive, values: Values, made_at: Monotonic) -> Deadline:
    action = action_for(values)
    return Deadline(made_at, kind_of_command(action).timeout_s(action, bus))


async def _sent(
    commands: CommandService,
    person: Person,
    values: Values,
    id: str,
    deadline: Deadline | None,
    scales: Scales,
) -> dict[ValuePlace, Result | UnitOutcome | Message]:
    try:
        result = await commands.send(
            person,
            action_for(values),
            deadline=deadline,
            confirm=True,
            id=id,
            origin="change tray",
            scales=scales,
        )
    except Problem as problem:
        return dict.fromkeys(values, problem.message)
    by_unit = {part.unit: part for part in result.units} if len(values) > 1 else {}
    return {place: by_unit.get(place.unit, result) for place in values}


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)
GATHERS = [permitted(SET_LINE)]
SEE_OTHER = 303
TITLE = term("Change tray")
_REVIEWED = re.compile(r"([a-z]+-\d+-\d+):(\d{1,6}):(\d{0,6})", re.ASCII)


class ReviewedRow(NamedTuple):
    """A change as the person saw it: the new raw value, and the old one as text (empty: none)."""

    raw: int
    was: str


class ShownResult(NamedTuple):
    """A change and its result. ``undo``: of the command, at the command's first change."""

    row: TrayRow
    outcome: OutcomeText
    undo: UndoOffer | None


@router.get("/tray", dependencies=GATHERS)
async def tray_page(page: Page) -> Response:
    """Show the changes that the person has gathered for each bus."""
    trays = [OwnTray(bus) for bus in page.buses()]
    buses = [(tray.page.name, rows) for tray in trays if (rows := tray.rows())]
    return page.render("tray/page.html", buses=buses, names=[tray.page.name for tray in trays])


@router.get("/tray/strip", dependencies=GATHERS)
async def tray_strip(page: Page) -> Response:
    """Show the number of changes in the tray, at the edge of the open page."""
    return page.render("tray/_strip.html")


@router.get("/bus/{bus}/tray/review", dependencies=GATHERS)
async def review_tray(page: PageOfBus) -> Response:
    """Show every change against the present values, to be confirmed."""
    tray = OwnTray(page)
    try:
        _refuse_without_control(page)
        await tray.learn()
        rows = tray.rows()
        unable = unable_units(rows)
        _refuse_outsiders(page, [row for row in rows if row.place.unit not in unable])
        return _review(page, tray)
    except Problem as problem:
        return _refused(page, problem)


@router.post("/bus/{bus}/tray/remove", dependencies=GATHERS)
async def remove_from_tray(page: PageOfBus, place: Annotated[str, Form(max_length=40)] = "") -> Response:
    """Remove one change or, with an empty place, all changes of the bus. Raise Problem 422 for a form without
    one."""
    await page.refuse_incomplete("place")
    tray = OwnTray(page)
    held, named = tray.changes, place_of(place)
    await tray.remove({each: raw for each, raw in held.items() if not place or each == named})
    return _review(page, tray) if _is_in_page(page) else RedirectResponse("/tray", SEE_OTHER)


def _review(page: BusPage, tray: OwnTray) -> Response:
    rows = tray.rows()
    if not rows:
        return _shown(page, "tray/_empty.html")
    unable = unable_units(rows)
    able = [row for row in rows if row.place.unit not in unable]
    setpoints = {row.place.unit: row.raw for row in able if row.place.kind == "setpoint"}
    return _shown(
        page,
        "tray/_review.html",
        rows=rows,
        able=len(able),
        unable=unable.values(),
        followers=followers_of(page.bus),
        warnings=by_remark((row.name, warning) for row in able for warning in row.warnings),
        dangers=by_remark((row.name, term(row.danger)) for row in able if row.danger),
        draws=draw_changes(page.bus, setpoints),
        word=CONFIRMING_WORD,
        longest_s=_longest_s(page, {row.place: row.raw for row in able}),
    )


def _refuse_without_control(page: BusPage) -> None:
    """Raise Problem 409, for which a page offers control of the bus."""
    objection = page.guards.objection(page.person.account)
    if objection is not None:
        raise controlled(Message.of("nothing_sent", reason=objection), page.name)


def _refuse_outsiders(page: BusPage, rows: Iterable[TrayRow]) -> None:
    """Raise Problem 409 if a unit outside the setpoints of a change would move with them."""
    if units := [row.place.unit for row in rows if row.place.kind == "setpoint"]:
        refuse_outsiders(page, units)


def _longest_s(page: BusPage, changes: Values) -> float:
    steps = steps_of(changes)
    return longest_change_s(page.bus, len(steps[0])) + len(steps) * timeout_s_for(page.bus) if steps else 0.0


@router.post("/bus/{bus}/tray/send", dependencies=[permitted_writer(SET_LINE)])
async def send_tray(
    request: Request,
    page: PageOfBus,
    confirmed: Confirmed,
    row: Annotated[list[str] | None, Form(max_length=512)] = None,
    typed: Annotated[str, Form(max_length=20)] = "",
) -> Response:
    """Send the reviewed changes, without the units that the person leaves out; send nothing if anything
    differs from the review."""
    tray, left_out = OwnTray(page), left_out_of(await request.form())
    try:
        if await page.has_sent(first_id(confirmed.id)):
            raise Problem(409, "not_in_state", Message("tray_sent_before"))
        confirmed.refuse_lapsed()
        _refuse_without_control(page)
        rows = _confirmed_rows(tray, _reviewed(row or []), left_out)
        if any(each.danger for each in rows) and typed.strip() != CONFIRMING_WORD:
            raise Problem(409, "dangerous", Message("word_not_typed"))
        _refuse_outsiders(page, rows)
        changes = {each.place: each.raw for each in rows}
        async with tray.sending(changes):
            results = await send_changes(
                page.commands, page.person, page.bus, changes, confirmed.id, page.made_at, tray.scales
            )
            await tray.remove({result.place: result.raw for result in results if result.is_done})
    except Problem as problem:
        return _refused(page, problem)
    return _done(page, rows, results, left_out)


def _reviewed(rows: list[str]) -> Mapping[ValuePlace, ReviewedRow]:
    """Parse the rows of a review. Raise Problem 422 for a text that no review has."""
    reviewed = {}
    for text in rows:
        found = _REVIEWED.fullmatch(text)
        place = None if found is None else place_of(found[1])
        if found is None or place is None:
            raise Problem(422, "invalid", Message("not_what_was_reviewed"))
        reviewed[place] = ReviewedRow(int(found[2]), found[3])
    return reviewed


def _confirmed_rows(
    tray: OwnTray, reviewed: Mapping[ValuePlace, ReviewedRow], left_out: set[int]
) -> list[TrayRow]:
    """Return the changes to send: all or none.

    Raise Problem 409 if the tray or a value has changed since the review, or if a unit that is not left out
    cannot take its change.
    """
    if tray.changes != {place: row.raw for place, row in reviewed.items()}:
        raise Problem(409, "moved", Message("tray_changed"))
    rows = [row for row in tray.rows() if row.place.unit not in left_out]
    if not rows:
        raise Problem(422, "invalid", Message("tray_all_left_out"))
    for row in rows:
        if reviewed[row.place].was != row.was_text:
            raise Problem(409, "moved", Message.of("tray_moved", name=row.name, what=row.what))
    for unable in unable_units(rows).values():
        reason = Message.of("unit_unable", name=unable.name, reason=unable.obstacle)
        raise Problem(409, "not_loadable", reason)
    return rows


def _done(page: BusPage, rows: list[TrayRow], results: list[TrayResult], left_out: set[int]) -> Response:
    by_place = {result.place: result for result in results}
    shown, commands = list[ShownResult](), set[str]()
    for row in rows:
        result = by_place[row.place]
        undo = None if result.id in commands else page.undo(result.id)
        commands.add(result.id)
        shown.append(ShownResult(row, _outcome(page, result), undo))
    good = sum(result.is_done for result in results)
    failed = failed_units((row.name, result) for row, result, _ in shown)
    some = Message.of("tray_result_of_some", n=len(results), good=good)
    tone: Tone = "good" if good == len(results) else "unknown" if _is_unknown(results) else "bad"
    return _shown(
        page,
        "tray/_done.html",
        results=shown,
        left_out=[(page.name_of(unit), page.outcome_left_out(unit)) for unit in sorted(left_out)],
        outcome=OutcomeText(
            tone,
            Message.of("tray_result_of_all", n=good) if tone == "good" else joined((some, *failed)) or some,
        ),
    )


def _is_unknown(results: list[TrayResult]) -> bool:
    return any(not isinstance(each.part, Message) and each.part.outcome == "unverified" for each in results)


def _outcome(page: BusPage, result: TrayResult) -> OutcomeText:
    place, part = result.place, result.part
    if isinstance(part, Message):
        return OutcomeText("bad", part)
    part = page.in_words(part)
    match place.kind:
        case "setpoint":
            return page.outcome(part, place.unit)
        case "parameter":
            unit, parameter = page.bus.units[place.unit], PARAMETERS[place.number]
            return outcome_text(part, lambda raw: parameter_message(parameter, raw, unit))
        case "output" if part.outcome == "verified":
            state = ON_OFF[result.raw]
            return OutcomeText("good", Message.of("result_output", n=place.number, state=state))
    return outcome_text(part)


def _refused(page: BusPage, problem: Problem) -> Response:
    """End a review without sending, where it is open. Raise Problem for a browser without scripts."""
    if not _is_in_page(page):
        raise problem
    response = page.refused(problem, page.translator.t(TITLE))
    response.headers["HX-Retarget"] = "#review-body"
    return response


def _shown(page: BusPage, template: str, **context: Any) -> Response:
    """Render a part of the open page or, for a browser without scripts, a full page."""
    context = {"bus": page.name, "part": template, "is_alone": not _is_in_page(page), **context}
    return page.review(template if _is_in_page(page) else "tray/alone.html", **context)


def _is_in_page(page: BusPage) -> bool:
    return bool(page.request.headers.get("hx-request"))


TypedText = Annotated[str, Form(max_length=40)]


async def _added(
    page: BusPage, changes: Values, deadline: Deadline | None = None, scales: Scales | None = None
) -> Response:
    await OwnTray(page).add(changes, deadline, scales)
    return page.render("tray/_added.html", added=len(changes))


def _setpoints(raw: Mapping[int, int]) -> Values:
    return {ValuePlace("setpoint", unit): value for unit, value in raw.items()}


@router.post("/units/{bus}/{unit:int}/tray/setpoint", dependencies=[permitted(SET_SPEED)])
async def add_setpoint(page: PageOfUnit, value: TypedText = "") -> Response:
    """Add a typed setpoint to the tray."""
    try:
        return await _added(page, _setpoints({page.id: (await page.typed_setpoint(page.id, value))[0]}))
    except (CallerError, Problem) as error:
        return explain_setpoint(page, error)


@router.post("/units/{bus}/{unit:int}/tray/outputs/{number:int}", dependencies=[permitted(WRITE_OUTPUT)])
async def add_output(page: PageOfUnit, number: OutputPath, on: Annotated[bool, Form()]) -> Response:
    """Add a state of an output to the tray."""
    try:
        return await _added(page, {ValuePlace("output", page.id, number): int(on)})
    except Problem as problem:
        return page.explain(problem, "#outputs-result", status=problem.status)


@router.post("/units/{bus}/{unit:int}/tray/analog-output", dependencies=[permitted(WRITE_ANALOG_OUTPUT)])
async def add_analog(page: PageOfUnit, value: TypedText = "") -> Response:
    """Add a typed value of the analog output to the tray."""
    try:
        return await _added(page, {ValuePlace("analog", page.id): typed_analog(value)})
    except (CallerError, Problem) as error:
        return page.explain(error, "#analog-error")


@router.post("/units/{bus}/{unit:int}/tray/parameters/{number:int}")
async def add_parameter(
    _: ParameterWriter,
    page: PageOfUnit,
    number: ParameterPath,
    raw: Annotated[int, Form(ge=0)],
    scale: ReviewedScale,
) -> Response:
    """Add a value of a parameter from its review."""
    try:
        return await _added(page, {ValuePlace("parameter", page.id, number): raw}, scales={page.id: scale})
    except Problem as problem:
        return page.explain(problem, f"#parameter-{number}-error")


@router.post("/bus/{bus}/tray/setpoints", dependencies=[permitted(SET_LINE)])
async def add_setpoints(request: Request, page: PageOfBus) -> Response:
    """Add every setpoint that was typed for a bus."""
    try:
        setpoints, scales = await typed_setpoints(page, await request.form())
        return await _added(page, _setpoints(setpoints), page.deadline(len(setpoints)), scales)
    except (CallerError, Problem) as error:
        return page.explain_setpoint(error)


@router.post("/recipes/{recipe_id}/tray", dependencies=[permitted(SET_LINE)])
async def add_recipe(page: Page, recipe: KnownRecipe) -> Response:
    """Add every setpoint of a recipe to the tray."""
    of_bus = page.of_bus(recipe.bus)
    try:
        for setpoint in recipe.setpoints:
            if reason := why_not_setpoint(setpoint, of_bus.bus):
                name = Message.of("unit_address", unit=setpoint.unit)
                raise Problem(409, "not_loadable", Message.of("of_unit", name=name, reason=reason))
        setpoints = {setpoint.unit: setpoint.raw for setpoint in recipe.setpoints}
        scales = {each.unit: parse_scale(each.scale) for each in recipe.setpoints if each.scale}
        return await _added(of_bus, _setpoints(setpoints), of_bus.deadline(len(setpoints)), scales)
    except Problem as problem:
        return page.explain(problem, f"#change-{of_bus.name}")


@router.post("/batch/{bus}/tray")
async def add_batch(request: Request, _: ParameterWriter, page: PageOfBus) -> Response:
    """Add each value of a batch edit that differs from its unit's."""
    number, typed = await typed_batch(request)
    parameter = writable_or_404(number)
    rows = rows_of_batch(page.bus, number, typed, page.guards.limits)
    if any(row.fault for row in rows):
        return refused_batch(page, parameter, rows)
    try:
        changes = {
            ValuePlace("parameter", row.unit, number): row.wanted
            for row in rows
            if row.changes and row.wanted is not None
        }
        if not changes:
            raise CallerError(Message("tray_nothing_to_add"))
        return await _added(page, changes, scales={row.unit: row.scale for row in rows})
    except (CallerError, Problem) as error:
        return page.explain(error, "#batch-error")


@router.post("/restores/{restore_id}/tray")
async def add_restore(
    person: ParameterWriter, page: Page, restores: Restores, restore: KnownRestore, row: Ticks = None
) -> Response:
    """Add the ticked rows of a restore, in the order of its plan."""
    of_bus = page.of_bus(restore.bus)
    try:
        restores.select(person, restore, ticked(restore, frozenset(row or ())))
        changes = {
            ValuePlace("parameter", restore.unit, write.number): write.wanted for write in restore.plan.writes
        }
        # A set's values are raw, and an earlier row may change the scale of a later row.
        return await _added(of_bus, changes, scales={restore.unit: {}})
    except Problem as problem:
        return page.explain(problem, "#restore-error")


class TrayCount(NamedTuple):
    """The changes that a person has gathered for one bus. ``units``: those with changes (``line/3``), each
    with its new setpoint or the number of its changes."""

    bus: str
    changes: int
    units: dict[str, str]


def _new_values(bus: BusLive, changes: Values, language: Language) -> dict[str, str]:
    """Return the units with changes, each with its new setpoint or the number of its changes."""
    counts = Counter(place.unit for place in changes)
    texts: dict[int, str] = {unit: language.tn("{n} change", "{n} changes", n) for unit, n in counts.items()}
    for place, raw in changes.items():
        if place.kind == "setpoint" and place.unit in bus.units:
            texts[place.unit] = language.t(setpoint_message(raw, bus.units[place.unit]))
    return {f"{bus.settings.name}/{unit}": text for unit, text in texts.items()}


def make(services: Services) -> None:
    for name, bus in services.buses.items():
        store = TrayStore(bus[BusLive], bus.add(Trays()), services[Database], services[EventLog])
        services.lifespan.add(f"change trays of {name}", start=bus.add(store).load)
    trays_of, lives = services.of_buses(Trays), services.of_buses(BusLive)

    def counted(person: Caller | None, language: Language) -> list[TrayCount]:
        if person is None:
            return []
        now = monotonic_now()
        held = {name: trays.changes(person.sender, now) for name, trays in trays_of.items()}
        return [
            TrayCount(name, len(changes), _new_values(lives[name], changes, language))
            for name, changes in held.items()
            if changes
        ]

    services[Templates].parts["trays"] = counted
    services[Finders].add_links("find_actions", [FixedPlace(Message("find_tray"), "/tray", "SetLine")])


FEATURE = Feature(make, (router,))
