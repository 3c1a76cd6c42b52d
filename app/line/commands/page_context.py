"""A request of a page that reviews or sends commands: of the site, of one bus, of one unit."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, TypeVar

from fastapi import Depends, Form
from msgspec.structs import replace as replace_fields
from starlette.requests import Request
from starlette.responses import Response

from app.core.web.access import Person, person_of
from app.core.web.arrival import Deadline, made_at, refuse_late
from app.core.web.services import bus_service_of, service_of
from app.core.web.templating import render, templates_of
from app.errors import Problem
from app.line.commands.catalogue import kind_of_command, timeout_s_for
from app.line.commands.record import CommandKey
from app.line.commands.review import (
    REVIEW_LASTS_S,
    OutcomeText,
    SetpointChange,
    change_of,
    obstacle_of,
    outcome_text,
    present_setpoint,
    ramp_parameters_missing,
)
from app.line.commands.rules import slows_all
from app.line.commands.safeguards import Safeguards
from app.line.commands.service import CommandService
from app.line.commands.undo import UndoOffer
from app.line.commands.values import Scales, parse_scale, setpoint_message, with_names
from app.line.live.bus_live import BusLive, LiveState, UnitLive
from app.line.live.fields import Fields, Translator
from app.line.live.hub import Hub
from app.line.live.pages import UnitOnLine, unit_on_line
from app.line.live.requests import unit_of_bus_or_404
from app.line.live.sources import Sources
from bus.contract import Action, Result, UnitOutcome, UnitScale
from bus.errors import CallerError
from bus.instants import UnixTime, unix_now
from bus.messages import Message

_RESULT: dict[str, Any] = {"requested": "", "reads": "", "undo": None, "controlled": ""}
"""The defaults of the context in which a result is rendered."""


@dataclass(frozen=True, slots=True)
class Confirmation:
    """The form of a confirmed review: the id of its command, when it was shown, and the id of the command
    that it undoes."""

    id: str
    reviewed_at: UnixTime
    undoes: str = ""

    def refuse_lapsed(self) -> None:
        """Raise Problem 409 for a review that is over."""
        if not unix_now() - self.reviewed_at <= REVIEW_LASTS_S:  # also for NaN
            raise Problem(409, "lapsed", Message("review_lapsed"))


class PageContext:
    """A request of a page: its user, its language, and the live state of the site."""

    def __init__(self, request: Request) -> None:
        templates = templates_of(request)
        language = templates.language_of(request).on_screen
        self.request = request
        self.translator = Translator(language, templates.formats(language.tag))
        self.live = service_of(request, LiveState)
        self.made_at = made_at(request)
        self.undoes = ""
        """The id of the command that the review undoes."""

    async def refuse_incomplete(self, *names: str) -> None:
        """Raise Problem 422 unless the form has every field named; a field may be empty."""
        form = await self.request.form()
        for name in names:
            if name not in form:
                raise Problem(422, "invalid", Message.of("form_incomplete", name=name))

    @property
    def person(self) -> Person:
        """The person with the grant of the request. Raises Problem 401."""
        return person_of(self.request)

    def of_bus(self, bus: str) -> BusPage:
        """Return this request for one bus. Raise Problem 404."""
        return BusPage(self.request, bus)

    def buses(self) -> list[BusPage]:
        """Return this request for each bus."""
        return [self.of_bus(name) for name in self.live.buses]

    def fields(self) -> Fields:
        """Return all texts of the screen as they are now."""
        return service_of(self.request, Hub).screen(self.translator.language.tag).flat()

    def render(self, template: str, /, *, status: int = 200, **context: Any) -> Response:
        """Render a template in the reader's language."""
        return render(self.request, template, status=status, **context)

    def review(self, template: str, /, **context: Any) -> Response:
        """Render a review: what will be done once it is confirmed, and the id of the command."""
        context = {"command_id": new_id(), "reviewed_at": unix_now(), "undoes": self.undoes, **context}
        return self.render(template, **context)

    def explain(
        self,
        reason: Message | CallerError | Problem,
        place: str,
        *,
        nearest: str | Message = "",
        field: str = "",
        status: int = 422,
    ) -> Response:
        """Render why there is no review, at the CSS selector ``place``, with an offer of control if that is
        missing. ``nearest``: the closest value that would be accepted, which a press enters into ``field``,
        the name of the one that is wrong; without it, the only one."""
        response = self.render(
            "unit/_no_review.html",
            reason=self.explanation(reason if isinstance(reason, Message) else reason.message),
            nearest=nearest,
            field=field,
            controlled=_controlled(reason),
            status=status,
        )
        response.headers["HX-Retarget"] = place
        return response

    def explanation(self, reason: Message) -> str:
        """Return a reason in the reader's language."""
        return self.translator.t(self.named(reason))

    def named(self, message: Message) -> Message:
        """Return a message with the names of the units that it is about, where the page is about a bus."""
        return message

    def refused(self, problem: Problem, title: str) -> Response:
        """Render the end of a review that sent nothing, in the dialog."""
        outcome, controlled = OutcomeText("bad", self.named(problem.message)), _controlled(problem)
        return self.render(
            "unit/_done.html", title=title, outcome=outcome, controlled=controlled, status=problem.status
        )


AnyResult = TypeVar("AnyResult", bound=Result | UnitOutcome)
_OUTSIDERS = ("outsider_unknown", "outsider_staged")


class BusPage(PageContext):
    """A request of a page about one bus. Raises Problem 404 for a bus that is not configured."""

    def __init__(self, request: Request, bus: str) -> None:
        super().__init__(request)
        self.name = bus
        self.bus = bus_service_of(request, bus, BusLive)
        self.commands = bus_service_of(request, bus, CommandService)
        self.guards = bus_service_of(request, bus, Safeguards)
        self._key = CommandKey("")

    def shown(self, unit: int) -> UnitOnLine:
        """Return a unit as the templates need it."""
        return unit_on_line(self.name, self.bus.units[unit])

    def deadline(self, staged_units: int = 0, *, typed: bool = True) -> Deadline:
        """Return the deadline of the command that this request sends. ``staged_units``: number of units of a
        change."""
        return Deadline(self.made_at, timeout_s_for(self.bus, staged_units, typed=typed))

    async def typed_setpoint(
        self, unit: int, text: str, deadline: Deadline | None = None
    ) -> tuple[int, UnitScale]:
        """Convert a typed setpoint; returns it, raw, with its scale. Raise CallerError and Problem."""
        return await self.commands.convert_setpoint(self.person, unit, text, deadline or self.deadline())

    def explain_setpoint(self, error: CallerError | Problem) -> Response:
        """Render why there is no review of several setpoints, and which of their fields is wrong."""
        unit, nearest = None, None
        if isinstance(error, Problem) and error.code == "invalid":
            unit, nearest = error.extra.get("unit"), error.extra.get("nearest")
        shown = "" if unit is None else setpoint_message(nearest, self.bus.units[unit])
        field = "" if unit is None else f"new-{unit}"
        return self.explain(error, f"#change-{self.name}", nearest=shown, field=field)

    def check(self, action: Action) -> None:
        """Check a command without reading anything. Raise Problem if it would not be sent."""
        self.commands.check(self.person, action, confirm=True)

    async def judge(self, action: Action, deadline: Deadline | None = None) -> None:
        """Check a command; parameters that bound it are read first, within its time. Raise Problem if it
        would not be sent."""
        await self.commands.read_ranges(self.person, action, deadline or self.deadline())
        self.check(action)

    async def know_ramps(self, units: Iterable[int]) -> None:
        """Read the ramp parameters that were never read; the ramp of a silent unit stays unknown."""
        deadline = self.deadline()

        async def read(unit: int, numbers: list[int]) -> None:
            with suppress(Problem):
                await self.commands.read(self.person, unit, numbers, deadline)

        missing = {unit: ramp_parameters_missing(self.bus.units[unit]) for unit in units}
        await asyncio.gather(*(read(unit, numbers) for unit, numbers in missing.items() if numbers))

    def undo(self, id: str) -> UndoOffer | None:
        """Return the undo of the command that this person has sent with this id; None if there is none."""
        return self.commands.undo.offer(self.person, id)

    async def send(
        self,
        action: Action,
        id: str,
        deadline: Deadline | None = None,
        undoes: str = "",
        scales: Scales | None = None,
    ) -> Result:
        """Send the reviewed command, once. ``deadline``: if not that of its kind; ``undoes``: the id of the
        command that it undoes; ``scales``: those of the review. Raise Problem if it is not sent."""
        timeout_s = kind_of_command(action).timeout_s(action, self.bus)
        deadline = deadline or Deadline(self.made_at, timeout_s)
        result = await self.commands.send(
            self.person,
            action,
            deadline=deadline,
            confirm=True,
            id=await self._look_up(id),
            origin="page",
            undoes=undoes,
            scales=scales,
        )
        return self.in_words(result)

    async def has_sent(self, id: str) -> bool:
        """Return whether the form was sent before: its command is then not checked again, and its result is
        shown."""
        return (await self._look_up(id)).is_used

    async def _look_up(self, id: str) -> CommandKey:
        """Look up an id, once in a request."""
        key = self._key
        if key.id != id:
            key = self._key = await self.commands.look_up(self.person, id)
        return key

    async def carry_out(
        self, action: Action, confirmation: Confirmation, scales: Scales | None = None
    ) -> Result:
        """Send a confirmed command while its review lasts; ``scales``: those of the review. Raise Problem if
        it is not sent."""
        if not await self.has_sent(confirmation.id):
            confirmation.refuse_lapsed()
        return await self.send(action, confirmation.id, undoes=confirmation.undoes, scales=scales)

    def outcome(self, result: Result | UnitOutcome, unit: int) -> OutcomeText:
        """Return words for a setpoint's result; the value read back has the decimals of ``unit``, and where
        it is another one, the reason why the unit takes none, if it is known."""
        words = outcome_text(result, lambda raw: setpoint_message(raw, self.bus.units[unit]))
        reason = self.obstacle(unit) if words.text.code == "result_reads_other" else None
        return (
            words
            if reason is None
            else replace(words, text=Message.of("result_because", result=words.text, reason=reason))
        )

    def in_words(self, result: AnyResult) -> AnyResult:
        """Return a result whose messages name the units, and show their speeds as they do."""
        parts = [self.in_words(part) for part in result.units] if isinstance(result, Result) else None
        unit = result.unit if isinstance(result, UnitOutcome) else None
        message = None if result.message is None else self.named(result.message, unit)
        return replace_fields(result, message=message, **({} if parts is None else {"units": parts}))

    def named(self, message: Message, unit: int | None = None) -> Message:
        """Return a message of the worker with the names of the units; one about a unit outside a change says
        what a person can do. ``unit``: the one of whose part in a change it is."""
        reason = message.params.get("reason")
        if isinstance(reason, Message) and reason.code in _OUTSIDERS:
            outsider = reason.params.get("unit")
            return self.would_move(outsider) if isinstance(outsider, int) else message
        return with_names(message, self.bus, unit)

    def would_move(self, unit: int) -> Message:
        """Return the message that names a unit that a change of other units would move too, with what a
        person can do about it."""
        live = self.bus.units.get(unit)
        obstacle = None if live is None else obstacle_of(self.bus, live, unix_now())
        is_local = obstacle is not None and obstacle.code == "obstacle_not_in_remote"
        return Message.of("outsider_in_local" if is_local else "outsider_silent", name=self.name_of(unit))

    def result(self, outcome: OutcomeText, *, status: int = 200, **setpoint: Any) -> Response:
        """Render the result of a command, in place. ``setpoint``: the requested value, its live field, its
        undo."""
        context = _RESULT | setpoint
        return self.render("unit/_result.html", outcome=outcome, status=status, **context)

    def not_sent(self, problem: Problem) -> Response:
        """Render the result of a confirmed review that sent nothing."""
        outcome = OutcomeText("bad", self.named(problem.message))
        return self.result(outcome, status=problem.status, controlled=_controlled(problem))

    def change(self, unit: int, raw: int, typed_with: UnitScale | None = None) -> SetpointChange:
        """Describe a new setpoint of a unit; ``typed_with``: its scale, if it was typed."""
        block = self.guards.block_reason(unit, slows=slows_all({unit: raw}, self.bus))
        live, limits, now = self.bus.units[unit], self.guards.limits(unit), unix_now()
        return change_of(self.bus, live, raw, limits, now, block=block, typed_with=typed_with)

    def obstacle(self, unit: int) -> Message | None:
        """Return why a unit cannot take a command now; None if there is no known reason."""
        block = self.guards.block_reason(unit)
        return obstacle_of(self.bus, self.bus.units[unit], unix_now(), block=block)

    def name_of(self, unit: int) -> str | Message:
        """Return the name of a unit, or its address if it is not configured."""
        live = self.bus.units.get(unit)
        return Message.of("unit_address", unit=unit) if live is None else live.settings.name

    def outcome_left_out(self, unit: int) -> OutcomeText:
        """Return words for a unit that a person left out of a change, and the reason if it still holds."""
        reason = self.obstacle(unit) if unit in self.bus.units else None
        left_out = Message("result_left_out_by_choice")
        return OutcomeText(
            "unknown", left_out if reason is None else Message.of("result_left_out", reason=reason)
        )

    def not_taking_part(self, taking_part: Iterable[int]) -> tuple[list[tuple[str, Message]], list[str]]:
        """Return the units that are not part of a change: those that could take no setpoint now, each with
        the reason, and the names of the rest."""
        taking = set(taking_part)
        others = [
            (unit.settings.name, self.obstacle(number))
            for number, unit in self.bus.units.items()
            if number not in taking
        ]
        left_out = [(name, obstacle) for name, obstacle in others if obstacle is not None]
        return left_out, [name for name, obstacle in others if obstacle is None]


class UnitPage(BusPage):
    """A request of a page about one unit. Raises Problem 404 for a unit that is not configured."""

    def __init__(self, request: Request, bus: str, unit: int) -> None:
        super().__init__(request, bus)
        self.id = unit
        self.unit: UnitLive = unit_of_bus_or_404(self.bus, unit)
        self.title = self.unit.settings.name
        self.on_line = self.shown(unit)

    def explanation(self, reason: Message) -> str:
        """Return a reason in the reader's language, without the unit, which the page names."""
        prefix = super().explanation(Message.of("unit_remark", unit=self.id, remark=""))
        return super().explanation(reason).removeprefix(prefix)

    def neighbor(self, step: Literal[-1, 1]) -> UnitOnLine | None:
        """Return the unit before or after this one in floor order; None at an end of the bus."""
        units = list(self.bus.units)
        at = units.index(self.id) + step
        return self.shown(units[at]) if 0 <= at < len(units) else None

    def golden_values(self) -> Mapping[int, Message]:
        """Return the value in the unit's golden set for each parameter that differs from it, by number."""
        drift = service_of(self.request, Sources).drift.get(self.name)
        return {} if drift is None else drift.golden_values(self.id)

    def setpoint(self, raw: int | None) -> str:
        """Return a setpoint as the unit shows it, in the reader's language; empty for None."""
        return self.translator.t(setpoint_message(raw, self.unit))

    @property
    def present(self) -> int | None:
        """The present setpoint, raw; None if it is not known."""
        return present_setpoint(self.bus, self.unit)


def _controlled(reason: Message | CallerError | Problem) -> str:
    """Return the bus whose control was missing; empty for another reason."""
    if isinstance(reason, Problem) and reason.code == "controlled":
        return str(reason.extra.get("bus", ""))
    return ""


def new_id() -> str:
    """Make the id of a command: a form that is posted twice is carried out once."""
    return uuid.uuid4().hex


async def _page_of_site(request: Request) -> PageContext:
    # A press that was delayed on its way ends here, as a Problem 503.
    refuse_late(request)
    return PageContext(request)


async def _page_of_bus(request: Request, bus: str) -> BusPage:
    refuse_late(request)
    return BusPage(request, bus)


async def unit_page_of(request: Request, bus: str, unit: int) -> UnitPage:
    """Return the request with its unit. Raise Problem 404, and 503 for a press that was delayed."""
    refuse_late(request)
    return UnitPage(request, bus, unit)


async def _confirmation_of(
    id: Annotated[str, Form(max_length=64)],
    reviewed_at: Annotated[UnixTime, Form()],
    undoes: Annotated[str, Form(max_length=64)] = "",
) -> Confirmation:
    return Confirmation(id, reviewed_at, undoes)


Page = Annotated[PageContext, Depends(_page_of_site)]
PageOfBus = Annotated[BusPage, Depends(_page_of_bus)]
PageOfUnit = Annotated[UnitPage, Depends(unit_page_of)]
Confirmed = Annotated[Confirmation, Depends(_confirmation_of)]


async def _scale_of(scale: Annotated[str | None, Form(max_length=400)] = None) -> UnitScale:
    return parse_scale(scale)


ReviewedScale = Annotated[UnitScale, Depends(_scale_of)]
"""The scale of the value in the review that is confirmed. Raises Problem 422 without it."""
