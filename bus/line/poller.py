"""The master of one bus: one exchange at a time, in the order of ``bus.line.schedule.arbiter``.

An answer's last byte and the next request's first byte are handled in the same breath: what follows a poll
is prepared while its answer is still under way (``_foresee``), and whatever else there is to do about an
answer is done once the next request has left.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from bus.contract import BusFigures, BusLink, BusLinkState, Watch
from bus.errors import CallerError, WireError
from bus.line.clock import LineClock, Timer
from bus.line.commands.command_run import CommandRun
from bus.line.commands.procedure import ExpectBaud, LineEffect, ReportProgress, Retune, Unstage
from bus.line.commands.result import ProcedureResult
from bus.line.events import CommandFinished, CommandProgressed, LineUpdate, Report
from bus.line.exchange.link import Link
from bus.line.exchange.send_attempts import ExchangeResult
from bus.line.port.port import OpenPort, PartlySent
from bus.line.roster import Roster
from bus.line.schedule.arbiter import Arbiter
from bus.line.schedule.baud_search import BaudSearch
from bus.line.schedule.command_queue import CommandQueue
from bus.line.schedule.poll_schedule import PollSchedule
from bus.line.statistics.figures import Figures
from bus.line.statistics.trace import Trace
from bus.messages import Message
from bus.settings import BusSettings, wire_seconds
from bus.wire.commands import Nak, ReadStatusRequest, Request, WriteParameterRequest
from bus.wire.lengths import usual_reply_bytes

CLOSED_TO_OFFLINE_S = 3.0


class Poller:
    """``report`` receives every event. Times of events are Unix time, those inside the line's own."""

    def __init__(self, bus: BusSettings, clock: LineClock, report: Report, seed: int = 0) -> None:
        self.bus = bus
        self.clock = clock
        self.baud: int = bus.baud
        self.trace = Trace()
        self.roster = Roster((unit.id for unit in bus.unit), clock.epoch(clock.now()))
        self.schedule = PollSchedule(self.roster.configured, self._exchange_s(ReadStatusRequest(1)), seed)
        self.link = Link(bus.dialect, bus.baud, bus.turnaround_s, clock, self.roster, self.trace)
        self.link.done = self._on_exchange_end
        self.state = self._port_is("closed", Message("port_not_opened"))
        self.lost: Callable[[Message], None] = lambda _cause: None
        """Called when the port proved unusable; whoever opened it opens it again."""
        self._report = report
        self._figures = Figures()
        self._arbiter = Arbiter(self.schedule, self.link.pending, self._exchange_s)
        self._baud_search = BaudSearch(clock.now())
        self._sending: Request | None = None
        self._held: list[LineUpdate] | None = None
        """What is told once the next request has left."""
        self._closed_at = clock.now()
        self._wake: Timer | None = None

    # --- the port ------------------------------------------------------------------------------

    def port_opened(self, port: OpenPort) -> None:
        """Ask from now on."""
        now = self.clock.now()
        self.link.attach(port, self.baud)
        self.schedule.port_opened(now)
        self.state = self._port_is("open")
        self._report([self.state])
        self._go(now)

    def port_lost(self, cause: Message) -> None:
        """Nothing can be asked; whatever was under way ends as unknown. Nothing is sent later."""
        now = self.clock.now()
        self._settle_last(self.link.detach(), now)
        self._arbiter.drop_routine(now)
        self._closed_at = now
        updates: list[LineUpdate] = self.not_opened(cause)
        updates += self.roster.port_closed(self.clock.epoch(now), cause)
        self._report(updates)
        for run in self.commands:
            run.close(now)
        self._sweep(now)
        self.lost(cause)

    def not_opened(self, cause: Message) -> list[LineUpdate]:
        """The port is closed, and why; tells it when that is news."""
        if self.state.link == "closed" and self.state.cause == cause:
            return []
        self.state = self._port_is("closed", cause)
        return [self.state]

    def _port_is(self, link: BusLinkState, cause: Message | None = None) -> BusLink:
        return BusLink(at=self.clock.epoch(self.clock.now()), link=link, cause=cause, baud=self.baud)

    def still_closed(self, cause: Message) -> None:
        """Another try to open it failed."""
        now = self.clock.now()
        updates = self.not_opened(cause)
        if now - self._closed_at > CLOSED_TO_OFFLINE_S:
            updates += self.roster.port_stays_closed(self.clock.epoch(now), cause)
        self._report(updates)

    def _settle_last(self, result: ExchangeResult | None, now: float) -> None:
        """The port broke while a request was on its way, or as it was handed over."""
        run, self._arbiter.owner = self._arbiter.owner, None
        self.trace.witness = None
        if run is None or run.result is not None or self._sending is None:
            return
        run.settle(result or ExchangeResult(self._sending, None, self.clock.epoch(now)), now)

    # --- the rate ------------------------------------------------------------------------------

    def tick(self) -> None:
        """Now and then: a line that fell silent may have come back at the rate it was given."""
        if not self.link.open or len(self.commands):
            return
        now = self.clock.now()
        if self._baud_search.look(now, self.baud, responds=self._responds) and not self.link.busy:
            self._go(now)

    @property
    def _responds(self) -> bool:
        """Whether any unit does at the present rate."""
        return len(self.schedule.poll_order) > 0

    def _retune(self, baud: int) -> None:
        """Everything from here on goes at ``baud``."""
        now = self.clock.now()
        self._baud_search.tuned(now)
        self.baud = baud
        try:
            self.link.retune(baud)
        except WireError as error:
            cause = error.message
            self.clock.call_at(now, lambda: self.port_lost(cause))
        else:
            self.state = msgspec.structs.replace(self.state, baud=baud)
            self._report_in_order([self.state])

    # --- what people want ----------------------------------------------------------------------

    @property
    def commands(self) -> CommandQueue:
        """All commands that wait or are under way."""
        return self._arbiter.commands

    def watch(self, watch: Watch) -> None:
        """These units are on an open page."""
        self.schedule.watch(watch.units, anybody=bool(watch.units))

    def reserve(self) -> None:
        """A write is about to be asked for: no poll leaves before it, for a moment."""
        self._arbiter.reserve(self.clock.now())
        self.link.do_not_follow()

    def submit(self, run: CommandRun) -> None:
        """Carry out ``run``: its first frame is the next one, if its priority allows."""
        now = self.clock.now()
        self.commands.add(run)
        self.link.do_not_follow()
        if not self.link.open:
            run.close(now)
            self._sweep(now)
        elif not self.link.busy:
            self._go(now)

    def cancel(self, command_id: str) -> None:
        """Give it up where nothing is half done."""
        self.commands.cancel(command_id)
        self._sweep(self.clock.now())

    def figures(self) -> BusFigures:
        """The figures of this moment."""
        now = self.clock.now()
        at = self.clock.epoch(now)
        return self._figures.take(now, at, self.link.counts, self.roster, self.schedule)

    # --- one exchange after the other ----------------------------------------------------------

    def _on_exchange_end(self, result: ExchangeResult, began: float, ended: float) -> None:
        """An ordinary answer changes nothing about who is next, so it is taken in after the next has left."""
        self.trace.witness = None
        unit = result.request.unit
        ordinary = (
            self._arbiter.owner is None and result.reply is not None and unit in self.schedule.poll_order
        )
        if result.overdue:
            self.commands.note_overdue(result.overdue)
        self._held = [] if ordinary else self._learn(result, ended)
        if self._arbiter.settle(result, began, ended):
            self.roster[unit].statistics.counts.retries += 1
        if self.link.busy:
            self._sending = self._arbiter.followed(ended)
        else:
            self._go(ended)
        told, self._held = self._held, None
        updates = [*self._learn(result, ended), *told] if ordinary else told
        if updates:
            self._report(updates)
        self._sweep(ended)
        self._foresee(ended)

    def _learn(self, result: ExchangeResult, now: float) -> list[LineUpdate]:
        request, reply = result.request, result.reply
        if request.unit == 0:
            return []
        if reply is None:
            updates: list[LineUpdate] = [*self.roster.missed(request.unit, self.clock.epoch(now))]
            if self.roster[request.unit].unresponsive and request.unit in self.schedule.poll_order:
                self.schedule.stopped_responding(request.unit, now)
            return updates
        assert result.responded_at is not None
        is_probe = result.dialect not in (None, self.bus.dialect)
        updates = [
            *self.roster.take_response(request, reply, result.responded_at, result.frame, is_probe=is_probe)
        ]
        if self.roster.is_configured(request.unit):
            self.schedule.responded(request.unit, now)
            if isinstance(request, WriteParameterRequest) and not isinstance(reply, Nak):
                self.schedule.parameters.need(request.unit)
        return updates

    def _foresee(self, now: float) -> None:
        """A request is on its way: have ready what follows it."""
        if self._sending is None or not self.link.busy or not self.link.paced:
            return
        following = self._arbiter.foresee(self._sending, now)
        if following is not None:
            self.link.prepare(following)

    def _go(self, now: float) -> None:
        """Send what is next; nothing to send: be waked when there is."""
        if not self.link.open:
            return
        other = self._baud_search.turn(self.baud, responds=self._responds)
        if other is not None:
            self._retune(other)
            self.schedule.port_opened(now)
        request = self._arbiter.next_request(now)
        if request is None:
            self._sleep(now)
            return
        self._send(request)

    def _send(self, request: Request) -> None:
        run = self._arbiter.owner
        self._sending = request
        self.trace.witness = run.frames if run is not None else None
        attempts = run.attempts if run is not None else None
        try:
            self.link.send(request, attempts.dialect_of(request) if attempts is not None else None)
        except PartlySent as error:
            self.port_lost(error.message)
        except WireError as error:
            self._sending = None
            self.port_lost(error.message)
        except CallerError as error:
            self._arbiter.owner = None
            if run is None:
                raise
            run.end(ProcedureResult("invalid", error.message))
            self._go(self.clock.now())
        else:
            if run is not None and attempts is not None and attempts.reports(request):
                self.apply(run.id, ReportProgress("sent", request.unit))

    def _exchange_s(self, request: Request) -> float:
        return wire_seconds(7 + usual_reply_bytes(request, self.bus), self.baud)

    # --- waiting and telling -------------------------------------------------------------------

    def _sleep(self, now: float) -> None:
        ahead = [moment for moment in self._arbiter.moments() if now < moment < float("inf")]
        if self._wake is not None:
            self._wake.cancel()
        self._wake = self.clock.call_at(min(ahead), self._waked) if ahead else None

    def _waked(self) -> None:
        self._wake = None
        if self.link.open and not self.link.busy:
            now = self.clock.now()
            self._go(now)
            self._sweep(now)

    def _sweep(self, now: float) -> None:
        """Report the result of every command that has one."""
        at = self.clock.epoch(now)
        for run in self.commands.take_finished():
            assert run.result is not None
            self._report([CommandFinished(run.id, at, run.result, run.frames)])

    def apply(self, command_id: str, step: LineEffect) -> None:
        """What a procedure tells on its way."""
        at = self.clock.epoch(self.clock.now())
        match step:
            case ReportProgress():
                self._report_in_order([CommandProgressed(command_id, at, step)])
            case Unstage():
                self._report_in_order([*self.roster.unstage(step.unit, at)])
            case Retune(baud=baud):
                self._retune(baud)
            case ExpectBaud(baud=baud):
                self._baud_search.expect(baud, self.baud)

    def _report_in_order(self, updates: list[LineUpdate]) -> None:
        """In the order of happening, but after the next request has left."""
        if self._held is not None:
            self._held += updates
        elif updates:
            self._report(updates)
