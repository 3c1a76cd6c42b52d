"""The loop of one bus: next request → exchange → settle. One exchange at a time, in one coroutine.

``bus.line.arbiter`` decides whose request is next, ``bus.line.link`` carries out the exchange.

Between the last byte of a response and the first of the next request the wire is idle, and 0.1 ms of that is
0.004 of the rate. Therefore, while the response to a poll is under way, the turn after it is chosen and its
exchange prepared. An ordinary response changes nothing about whose turn is next: after one the prepared
request leaves first, and the results are settled and reported while the next response is under way.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import NamedTuple

import msgspec

from bus.catalogue.parameters import SETPOINTS
from bus.contract import BusFigures, BusLink, BusLinkState, ParameterValue, Progress, Update
from bus.errors import CallerError, WireError
from bus.instants import Monotonic, UnixTime
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
from bus.line.link import Completion, CurrentExchange, Link, run_at_once
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
from bus.wire.exchange import Exchange

CLOSED_TO_OFFLINE_S = 3.0
NOT_OPENED = Message("port_not_opened")
WAIT_S = 0.1
"""The seconds for which a step of a command, or a parameter, waits for the next response: nobody sees a step
that is shorter, and each report takes the app half as much as a reading."""
MAX_PORT_REMARKS = 5
"""The number of newest remarks about the port that are kept."""


class NextExchange(NamedTuple):
    """A turn and its exchange, ready to be sent."""

    turn: NextRequest
    exchange: Exchange


class LineLoop:
    """The loop of one bus. ``report`` receives every event, in order, while the next response is under way.
    Times of events are Unix time, times of the loop are the line's own, in seconds."""

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
        poll_s = self._exchange_s(ReadStatusRequest(1))
        self.schedule = PollSchedule(self.roster.configured, poll_s, seed, least_scan_s=bus.least_scan_s)
        self.link = Link(self.dialect, bus.baud, bus.turnaround_s, clock, self.roster, self.trace)
        self.state = self._port_is("closed", NOT_OPENED)
        self._send_report = report
        self._events: list[Update] = []
        self._figures = Figures()
        self._arbiter = Arbiter(self.schedule, self.link.pending, self._exchange_s)
        self.commands = self._arbiter.commands
        """The commands that wait or are under way."""
        self._baud_search = BaudSearch(clock.now())
        self._closed_at = clock.now()
        self._port_remarks: dict[str, tuple[Message, Monotonic]] = {}
        """The remarks about the port by subject, each with the moment until which the diagnosis shows it."""
        self._resting: Completion[None] = Completion()
        self._ended: tuple[NextRequest, CurrentExchange] | None = None
        self._foreseen: NextExchange | None = None
        """The exchange that follows the one under way if its response is an ordinary one."""

    # --- the loop ------------------------------------------------------------------------------

    async def run(self, port: OpenPort) -> Message:
        """Use ``port`` until it is lost; return why it was."""
        return await run_at_once(self._take_turns(port))

    async def _take_turns(self, port: OpenPort) -> Message:
        self._port_opened(port)
        while self.link.open:
            is_foreseen = self._ended is not None and self._ended[1].is_ordinary
            following = self._foreseen if is_foreseen else None
            if following is None:
                self._settle()
                now = self.clock.now()
                following = self._next_exchange(now)
                if following is None:
                    await self._rest(now)
                    continue
            ending = self.link.send(following.exchange)
            if ending is not None:
                self._has_left(following)
                self._ended = following.turn, await ending
        return self._port_lost()

    def _next_exchange(self, now: Monotonic) -> NextExchange | None:
        if len(self.commands) == 0:
            responds = len(self.schedule.poll_order) > 0
            other = self._baud_search.turn(now, self.baud, responds=responds)
            if other is not None:
                self._retune(other)
                self.schedule.probes.forgive(now)
        while (turn := self._arbiter.next_request(now)) is not None:
            try:
                return self._prepare(turn)
            except CallerError as error:
                if turn.run is None:
                    raise
                turn.run.end(ProcedureResult("invalid", error.message))
        return None

    def _prepare(self, turn: NextRequest) -> NextExchange:
        """Prepare the exchange of ``turn``. Raise CallerError for a request that no frame can carry."""
        attempts = turn.run.attempts if turn.run is not None else None
        dialect = attempts.dialect_of(turn.request) if attempts is not None else None
        exchange = self.link.prepare(turn.request, dialect)
        if turn.run is not None:
            self.trace.witness = turn.run.frames
        return NextExchange(turn, exchange)

    def _has_left(self, sent: NextExchange) -> None:
        """Settle, report and prepare the next turn while the response to ``sent`` is under way."""
        self._settle()
        turn, run = sent.turn, sent.turn.run
        if sent is self._foreseen:
            self._arbiter.follow(self.clock.now())
        if run is not None and run.attempts is not None and run.attempts.reports(turn.request):
            self.apply(run.id, ReportProgress("sent", turn.request.unit))
        self._report(until_s=self._exchange_s(turn.request))
        following = self._arbiter.foresee(turn, self.clock.now()) if self.link.is_paced else None
        self._foreseen = self._prepare(following) if following is not None else None

    def _settle(self) -> None:
        """Take the result of the exchange that has ended, if any."""
        if self._ended is None:
            return
        self.link.account()
        self.trace.witness = None
        (turn, ended), self._ended = self._ended, None
        result = ended.result(self.clock)
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
                # A person who has changed one parameter at the keypad may have changed the scale too.
                self.schedule.parameters.need(request.unit)

    async def _rest(self, now: Monotonic) -> None:
        """Wait until something may become due that was not at ``now``, or until the loop is woken."""
        self._report()
        self._resting = Completion()
        moments = [moment for moment in self._arbiter.moments() if now < moment < NEVER]
        alarm = self.clock.call_at(min(moments), self._wake) if moments else None
        try:
            await self._resting
        finally:
            if alarm is not None:
                alarm.cancel()

    def _wake(self) -> None:
        if not self._resting.is_set:
            self._resting.set(None)

    def _report(self, until_s: float = inf) -> None:
        """Report every event since the last report, and the result of every command that has one.
        ``until_s``: the seconds until the response under way, with which steps and parameters may go."""
        at = self.clock.epoch(self.clock.now())
        for run in self.commands.take_finished():
            self._events.append(run.report(at, self.dialect))
        if self._events and not self._may_wait(at + until_s):
            events, self._events = self._events, []
            self._send_report(events)

    def _may_wait(self, until: UnixTime) -> bool:
        """Return whether every event is a step of a command or a parameter, and may be reported as late as
        ``until``."""
        return all(
            isinstance(event, Progress | ParameterValue) and until - event.at <= WAIT_S
            for event in self._events
        )

    def _exchange_s(self, request: Request) -> float:
        return wire_seconds(7 + usual_reply_bytes(request, self.bus), self.baud)

    # --- the port ------------------------------------------------------------------------------

    def lose_port(self, cause: Message) -> None:
        """Give up the port; the exchange under way ends without a response."""
        self.link.lose(cause)
        self._wake()

    def still_closed(self, cause: Message) -> None:
        """Note that another attempt to open the port failed."""
        now = self.clock.now()
        self._port_closed(cause)
        if now - self._closed_at > CLOSED_TO_OFFLINE_S:
            lost = self.roster.port_closed(self.clock.epoch(now), cause, long=True)
            for link in lost:
                # While nobody looked it may have been set up anew, or replaced.
                self.schedule.parameters.need(link.unit)
            self._events += lost
        self._report()

    def note_port(self, remark: Message, *, about: str, lasts_s: float) -> None:
        """Show ``remark`` in the diagnosis for ``lasts_s``; an earlier one ``about`` the same is
        prolonged."""
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
        """Report the port as open. A lost port is back with the first response, or once it has stayed open
        for a while, since a device server that shuts down may still accept connections."""
        if self.link.open and self.state.link == "closed":
            self.state = self._port_is("open")
            self._events.append(self.state)
            self._wake()

    def _port_lost(self) -> Message:
        """End everything under way as unknown, so that nothing is sent later, and return the cause."""
        assert self.link.loss is not None
        self._foreseen = self.trace.witness = None
        self._settle()
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
        self._foreseen = None
        self._arbiter.reserve(self.clock.now())

    def submit(self, run: CommandRun) -> None:
        """Queue ``run``: its first request is the next one, if its priority allows."""
        self._foreseen = None
        self.commands.add(run)
        if self.link.open:
            self._wake()
        else:
            run.close(self.clock.now())
            self._report()

    def cancel(self, command_id: str) -> None:
        """Cancel a command at its next point where nothing is half done."""
        self.commands.cancel(command_id)
        self._report()

    def apply(self, command_id: str, effect: LineEffect) -> None:
        """Carry out a step of a procedure that is no request and no pause."""
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
        figures = self._figures.measure(now, at, self.link.counts, self.roster, self.schedule)
        other = self.link.second_master
        return msgspec.structs.replace(
            figures,
            has_second_master=other.is_present(now),
            unrequested=other.noted,
            diagnosis=[*self._diagnosis_of_port(now), *figures.diagnosis],
        )
