"""Shared by every form of the pages: the user, the language, and whether the review is still valid."""

from __future__ import annotations

import uuid
from typing import Annotated, Any

from fastapi import Depends
from starlette.requests import Request
from starlette.responses import Response

from app.commands.catalogue import kind_of_command, timeout_s_for
from app.commands.forms.outcome import OutcomeText, outcome_text, problem_text
from app.commands.safeguards.service import Safeguards
from app.commands.service.command_service import CommandService
from app.commands.values import setpoint_message
from app.errors import Problem
from app.live.browsers.hub import Hub
from app.live.lookup import bus_or_404, unit_or_404
from app.live.pages import UnitOnLine, unit_on_line
from app.live.screen.fields import Translator
from app.live.state.bus_live import BusLive, LiveState, UnitLive
from app.web.access import Person
from app.web.arrival import Deadline, made_at, refuse_late
from app.web.services import bus_service_of, service_of
from app.web.templating import render, templates_of
from bus.contract import Action, Result, UnitOutcome
from bus.instants import UnixTime, unix_now
from bus.messages import Message

REVIEW_LASTS_S = 45.0
"""Thirty seconds on the screen, and something for the way."""


class PageContext:
    """One request of a page: its unit or bus, its language, and the way to the wire."""

    def __init__(self, request: Request) -> None:
        self.request = request
        templates = templates_of(request)
        language = templates.language_of(request)
        self.translator = Translator(language, templates.formats(language.tag))
        self.live = service_of(request, LiveState)
        self.made_at = made_at(request)

    def bus(self, name: str) -> BusLive:
        """Raises Problem 404."""
        return bus_or_404(self.live, name)

    def commands(self, bus: str) -> CommandService:
        """Raises Problem 404."""
        return bus_service_of(self.request, bus, CommandService)

    def guards(self, bus: str) -> Safeguards:
        """Raises Problem 404."""
        return bus_service_of(self.request, bus, Safeguards)

    def unit(self, bus: str, unit: int) -> UnitLive:
        """Raises Problem 404."""
        return unit_or_404(self.live, bus, unit)

    def shown(self, bus: str, unit: int) -> UnitOnLine:
        """A unit as the templates want it."""
        return unit_on_line(bus, self.unit(bus, unit))

    def fields(self) -> dict[str, str]:
        """All texts of the screen as they are now."""
        return service_of(self.request, Hub).screen(self.translator.language.tag).flat()

    def setpoint(self, raw: int | None, unit: UnitLive) -> str:
        """A setpoint as the unit shows it, in the reader's language; empty where there is none."""
        return self.translator.t(setpoint_message(raw, unit))

    def people(self) -> dict[str, str]:
        """Return the role of each user with an open page, keyed by user name."""
        return service_of(self.request, Hub).people()

    def render(self, template: str, /, *, status: int = 200, **context: Any) -> Response:
        return render(self.request, template, status=status, **context)

    def review(self, template: str, /, **context: Any) -> Response:
        """The second step: what will be done once this is confirmed, and the id it will be done under."""
        return self.render(template, command_id=new_id(), reviewed_at=unix_now(), **context)

    def not_so(self, reason: str, place: str, *, nearest: str = "", status: int = 422) -> Response:
        """Why there is no review, shown at the CSS selector ``place``; ``nearest`` would get one."""
        response = self.render("unit/_not_so.html", reason=reason, nearest=nearest, status=status)
        response.headers["HX-Retarget"] = place
        return response

    def refuse_lapsed(self, reviewed_at: UnixTime) -> None:
        """Raises Problem 409 for a review that is over. Nothing is sent."""
        if not unix_now() - reviewed_at <= REVIEW_LASTS_S:  # of NaN too
            raise Problem(409, "lapsed", Message("review_lapsed"))

    def deadline(self, bus: BusLive, staged_units: int = 0) -> Deadline:
        """Deadline of the command that this request sends. ``staged_units``: number of units of a change."""
        return Deadline(self.made_at, timeout_s_for(bus, staged_units))

    async def send(
        self, person: Person, bus: str, action: Action, id: str, deadline: Deadline | None = None
    ) -> Result:
        """Send the reviewed command, once; ``deadline`` where it is not that of its kind.

        Raises Problem where it is not sent.
        """
        timeout_s = kind_of_command(action).timeout_s(action, self.bus(bus))
        deadline = deadline or Deadline(self.made_at, timeout_s)
        commands = self.commands(bus)
        return await commands.send(person, action, deadline=deadline, confirm=True, id=id, origin="page")

    def outcome(self, result: Result | UnitOutcome, unit: UnitLive | None = None) -> OutcomeText:
        """What became of it; what was read back is a setpoint in the decimals of ``unit``, else as it is."""
        if unit is None:
            return outcome_text(result, str, self.translator)
        return outcome_text(result, lambda raw: self.setpoint(raw, unit), self.translator)

    def refused(self, problem: Problem, title: str) -> Response:
        """The end of a review that sent nothing, in the dialog."""
        return self.done(title, problem_text(problem, self.translator), status=problem.status)

    def done(self, title: str, outcome: OutcomeText, *, status: int = 200, **setpoint: Any) -> Response:
        """The end of a review, in the dialog. ``setpoint``: the requested value, its live field, its undo."""
        context = {"requested": "", "reads": "", "undo": ""} | setpoint
        return self.render("unit/_done.html", title=title, outcome=outcome, status=status, **context)


def new_id() -> str:
    """The identity of a command: a form that is posted twice is carried out once."""
    return uuid.uuid4().hex


async def page_context_of(request: Request) -> PageContext:
    """This request's. Raises Problem 503 for a press that was held up on its way."""
    refuse_late(request)
    return PageContext(request)


Page = Annotated[PageContext, Depends(page_context_of)]
