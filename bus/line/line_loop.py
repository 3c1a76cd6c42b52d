"""The loop of one bus: next request → exchange → settle. One exchange at a time, in one coroutine.

``bus.line.arbiter`` decides whose request is next, ``bus.line.link`` carries out the
exchange.

The next request leaves as soon as the response before it is settled. What that led to is reported while the
next response is under way, because until the request leaves the wire is idle.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import msgspec

from bus.catalogue.parameters import SETPOINTS
from bus.contract import BusFigures, BusLink, BusLinkState, Progress, Update
from bus.errors import CallerError, WireError
from bus.instants import Monotonic
from bus.line.arbiter import Arbiter, NextRequest
from bus.line.commands.procedure import (
    CommandRun,
    ExpectBaud,
    LineEffect,
    NoteStagedScale,
    ProcedureResult,
    ReportProgress,
    Retune,
    Unstage,
)
from bus.line.diagnosis import Figures
from bus.line.link import Link
from bus.line.poll_schedule import BaudSearch, PollSchedule
from bus.line.port import OpenPort
from bus.line.roster import Roster
from bus.line.send import ExchangeResult
from bus.line.timing import NEVER, LineClock
from bus.line.trace import Trace
from bus.messages import Message
from bus.settings import BusSettings, wire_seconds
from bus.wire.commands import (
    Nak,
    ReadParameterRequest,
    ReadStatusRequest,
    Request,
    StageSpeedRequest,
    WriteParameterRequest,
    usual_reply_bytes,
)

CLOSED_TO_OFFLINE_S = 3.0
NOT_OPENED = Message("port_not_opened")
MAX_PORT_REMARKS = 5
"""The newest ones are kept."""


class LineLoop:
    """``report`` receives every event, in order, while the response to the next request is under way.

    Times of events are Unix time, those of the loop the line's own.
    """

    def __init__(
        self,
        bus: BusSettings,
        clock: LineClock,
        report: Callable[[list[Update]], None],
        seed: int = 0,
    ) -> None:
        self.bus = bus
        self.dialect = bus.dialect
        self.clock = clock
        self.baud: int = bus.baud
        self.trace = Trace()
        self.roster = Roster((unit.id for unit in bus.unit), clock.epoch(clock.now()))
        self.schedule = PollSchedule(self.roster.configured, self._exchange_s(ReadStatusRequest(1)), seed)
        self.link = Link(self.dialect, bus.baud, bus.turnaround_s, clock, self.roster, self.trace)
        self.state = self._port_is("closed", NOT_OPENED)
        self._send_report = report
        self._events: list[Update] = []
        self._figures = Figures()
        self._arbiter = Arbiter(self.schedule, self.link.pending, self._exchange_s)
        self.commands = self._arbiter.commands
        """All that wait or are under way."""
        self._baud_search = BaudSearch(clock.now())
        self._closed_at = clock.now()
        self._port_remarks: dict[str, tuple[Message, Monotonic]] = {}
        """What is wrong about the port, until when it is in the diagnosis."""
        self._woken = asyncio.Event()

    # --- the loop ------------------------------------------------------------------------------

    async def run(self, port: OpenPort) -> Message:
        """Use ``port`` until it is lost; return why it was."""
        self._port_opened(port)
        while self.link.open:
            now = self.clock.now()
            turn = self._next_request(now)
            if turn is None:
                await self._rest(now)
            elif (ending := self._send(turn)) is not None:
                self._settle(turn, await ending)
        return self._port_lost()

    def _next_request(self, now: Monotonic) -> NextRequest | None:
        if len(self.commands) == 0:
            responds = len(self.schedule.poll_order) > 0
            other = self._baud_search.turn(now, self.baud, responds=responds)
            if other is not None:
                self._retune(other)
                self.schedule.probes.forgive(now)
        return self._arbiter.next_request(now)

    def _send(self, turn: NextRequest) -> asyncio.Future[ExchangeResult] | None:
        """Send the request of ``turn`` and return how its exchange will have ended. Return None where it was
        not sent, because the port is lost or no frame can carry it."""
        request, run = turn
        attempts = run.attempts if run is not None else None
        self.trace.witness = run.frames if run is not None else None
        reports = attempts is not None and attempts.reports(request)
        try:
            ending = self.link.send(request, attempts.dialect_of(request) if attempts is not None else None)
        except CallerError as error:
            if run is None:
                raise
            run.end(ProcedureResult("invalid", error.message))
            return None
        if run is not None and reports and ending is not None:
            self.apply(run.id, ReportProgress("sent", request.unit))
        self._report()
        return ending

    def _settle(self, turn: NextRequest, result: ExchangeResult) -> None:
        """Take the result of the exchange that has ended."""
        self.trace.witness = None
        if result.reply is None and isinstance(result.request, StageSpeedRequest):
            self._events += self.roster.stage_unanswered(result.request.unit, self.clock.epoch(result.ended))
        if result.reply is not None or self.link.open:
            self._learn(result)
        if result.overdue:
            self.commands.note_overdue(result.overdue)
        if self._arbiter.settle(turn, result):
            self.roster[turn.request.unit].statistics.counts.retries += 1

    def _learn(self, result: ExchangeResult) -> None:
        request, reply, now = result.request, result.reply, result.ended
        if request.unit == 0:
            return
        if reply is None:
            self._events += self.roster.missed(request.unit, self.clock.epoch(now))
            if self.roster[request.unit].unresponsive and request.unit in self.schedule.poll_order:
                self.schedule.stopped_responding(request.unit, now)
            return
        assert result.responded_at is not None
        if self.state.link == "closed":
            self.port_is_back()
        is_probe = result.dialect not in (None, self.dialect)
        number = request.number if isinstance(request, ReadParameterRequest) else 0
        record = self.roster[request.unit]
        former = record.raw(number)
        self._events += self.roster.take_response(
            request, reply, result.responded_at, result.frame, is_probe=is_probe
        )
        if self.roster.is_configured(request.unit):
            self.schedule.responded(request.unit, now)
            is_changed = former not in (None, record.raw(number)) and number not in SETPOINTS
            if is_changed or (isinstance(request, WriteParameterRequest) and not isinstance(reply, Nak)):
                # Who has changed one parameter at the keypad may have changed the scale too.
                self.schedule.parameters.need(request.unit)

    async def _rest(self, now: Monotonic) -> None:
        """Wait until something may be due that was not at ``now``, or the loop is woken."""
        self._report()
        self._woken.clear()
        moments = [moment for moment in self._arbiter.moments() if now < moment < NEVER]
        alarm = self.clock.call_at(min(moments), self._woken.set) if moments else None
        try:
            await self._woken.wait()
        finally:
            if alarm is not None:
                alarm.cancel()

    def _report(self) -> None:
        """Report every event since the last report, and the result of every command that has one."""
        at = self.clock.epoch(self.clock.now())
        for run in self.commands.take_finished():
            self._events.append(run.report(at, self.dialect))
        if self._events:
            events, self._events = self._events, []
            self._send_report(events)

    def _exchange_s(self, request: Request) -> float:
        return wire_seconds(7 + usual_reply_bytes(request, self.bus), self.baud)

    # --- the port ------------------------------------------------------------------------------

    def lose_port(self, cause: Message) -> None:
        """Give up the port; the exchange under way ends without a response."""
        self.link.lose(cause)
        self._woken.set()

    def still_closed(self, cause: Message) -> None:
        """Note that another attempt to open it failed."""
        now = self.clock.now()
        self._port_closed(cause)
        if now - self._closed_at > CLOSED_TO_OFFLINE_S:
            self._events += self.roster.port_closed(self.clock.epoch(now), cause, long=True)
        self._report()

    def note_port(self, remark: Message, *, about: str, lasts_s: float) -> None:
        """Have ``remark`` in the diagnosis for a while; while there is one ``about`` the same, that stays."""
        known, _ = self._port_remarks.pop(about, (remark, None))
        self._port_remarks[about] = known, self.clock.now() + lasts_s
        if len(self._port_remarks) > MAX_PORT_REMARKS:
            del self._port_remarks[next(iter(self._port_remarks))]

    def _diagnosis_of_port(self, now: Monotonic) -> list[Message]:
        self._port_remarks = {about: each for about, each in self._port_remarks.items() if each[1] > now}
        return [remark for remark, _ in self._port_remarks.values()]

    def _port_opened(self, port: OpenPort) -> None:
        self.link.attach(port, self.baud)
        self.schedule.probes.forgive(self.clock.now())
        if self.state.cause == NOT_OPENED:
            self.port_is_back()

    def port_is_back(self) -> None:
        """Report the port as open. One that was lost is back with the first response, or once it has stayed
        open for a while: a device server that ends may still accept connections."""
        if self.link.open and self.state.link == "closed":
            self.state = self._port_is("open")
            self._events.append(self.state)
            self._woken.set()

    def _port_lost(self) -> Message:
        """End whatever was under way as unknown, and return the cause; nothing is sent later."""
        assert self.link.loss is not None
        self.trace.witness = None
        now, cause = self.clock.now(), self.link.loss
        if self.state.link == "open":
            self._closed_at = now
        self._port_closed(cause)
        self._events += self.roster.port_closed(self.clock.epoch(now), cause)
        for run in self.commands:
            run.close(now)
        self._report()
        return cause

    def _port_closed(self, cause: Message) -> None:
        if self.state.link != "closed" or self.state.cause != cause:
            self.state = self._port_is("closed", cause)
            self._events.append(self.state)

    def _port_is(self, link: BusLinkState, cause: Message | None = None) -> BusLink:
        return BusLink(at=self.clock.epoch(self.clock.now()), link=link, cause=cause, baud=self.baud)

    # --- the rate ------------------------------------------------------------------------------

    def _retune(self, baud: int) -> None:
        self._baud_search.tuned(self.clock.now())
        self.baud = baud
        try:
            self.link.retune(baud)
        except WireError as error:
            self.link.lose(error.message)
        else:
            self.state = msgspec.structs.replace(self.state, baud=baud)
            self._events.append(self.state)

    # --- commands ------------------------------------------------------------------------------

    def reserve(self) -> None:
        """Hold back polls for a moment, because a write is about to be requested."""
        self._arbiter.reserve(self.clock.now())

    def submit(self, run: CommandRun) -> None:
        """Carry out ``run``: its first request is the next one, if its priority allows."""
        self.commands.add(run)
        if self.link.open:
            self._woken.set()
        else:
            run.close(self.clock.now())
            self._report()

    def cancel(self, command_id: str) -> None:
        """Give up a command at a point where nothing is half done."""
        self.commands.cancel(command_id)
        self._report()

    def apply(self, command_id: str, effect: LineEffect) -> None:
        """Carry out what a procedure does beside its requests."""
        at = self.clock.epoch(self.clock.now())
        match effect:
            case ReportProgress():
                progress = Progress(command_id, at, effect.stage, effect.unit, effect.done, effect.of)
                self._events.append(progress)
            case Unstage():
                self._events += self.roster.stage(effect.unit, None, at)
            case NoteStagedScale(unit=unit, scale=scale):
                self.roster[unit].staged_scale = scale
            case Retune(baud=baud):
                self._retune(baud)
            case ExpectBaud(baud=baud):
                self._baud_search.expect(baud, self.baud)

    def figures(self) -> BusFigures:
        now = self.clock.now()
        at = self.clock.epoch(now)
        figures = self._figures.take(now, at, self.link.counts, self.roster, self.schedule)
        other = self.link.second_master
        return msgspec.structs.replace(
            figures,
            has_second_master=other.is_present(now),
            unrequested=other.noted,
            diagnosis=[*self._diagnosis_of_port(now), *figures.diagnosis],
        )
