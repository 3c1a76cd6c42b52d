"""The master of one bus: operators' errands first, then the schedule, one exchange at a time.

An answer's last byte and the next request's first byte are handled in the same breath: ``_heard`` takes
the answer in, chooses and sends what is next, and only then tells anybody.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from bus.contract import BusFigures, BusLink, Progress, Result, Update, Watch
from bus.errors import CallerError, WireError
from bus.line.asking import Asking, Heard
from bus.line.clock import Alarm, Clock
from bus.line.errand import Claim, Errand
from bus.line.errands import Errands
from bus.line.figures import Figures
from bus.line.link import Link
from bus.line.port import OpenPort, PartlySent
from bus.line.roster import Roster
from bus.line.schedule import Kind, Schedule, Task
from bus.line.steps import Ask, Expect, Note, Retune, Tell, Unstage
from bus.line.trace import Interpreter, Trace
from bus.settings import BusSettings
from bus.wire.commands import (
    Nak,
    ReadParameter,
    ReadStatus,
    Request,
    WriteParameter,
    usual_reply_bytes,
    wire_seconds,
)

ERRANDS_AT_A_STRETCH_S = 0.5
"""Operators' writes without end leave one poll in this time, unless a change of many units is under way."""
PACE = 0.8
"""On a port faster than its baud rate a round still takes this part of the time it would on the wire."""
CLOSED_TO_OFFLINE_S = 3.0
LOOK_ELSEWHERE_S = 3.0
"""How long a wholly silent line is asked at one baud rate before it is asked at the other."""
_TRIES = {Kind.FIRST: 1, Kind.PROBE: 1}


class Poller:
    """``emit`` hears every update. Times of the outside are epoch seconds, inside the line's own."""

    def __init__(
        self, bus: BusSettings, clock: Clock, emit: Callable[[list[Update]], None], seed: int = 0
    ) -> None:
        self.bus = bus
        self.clock = clock
        self.baud: int = bus.baud
        self.trace = Trace()
        self.roster = Roster((unit.id for unit in bus.unit), clock.epoch(clock.now()))
        self.schedule = Schedule(self.roster.configured, self._poll_s(), seed)
        self.link = Link(bus.dialect, bus.baud, bus.turnaround_s, clock, self.roster, self.trace)
        self.link.done = self._heard
        self.state = BusLink(at=clock.epoch(clock.now()), link="closed", cause="not opened yet")
        self.lost: Callable[[str], None] = lambda _cause: None
        """Called when the port proved unusable; whoever opened it opens it again."""
        self._emit = emit
        self._figures = Figures()
        self.errands = Errands()
        self._routine: tuple[Task, Asking] | None = None
        self._owner: Errand | None = None
        self._sending: Request | None = None
        self._held: list[Update] | None = None
        """What is told once the next request has left."""
        self._routine_at = 0.0
        self._not_before = 0.0
        self._tuned_at = clock.now()
        self._expected_baud: int | None = None
        self._look_elsewhere = False
        self._closed_at = clock.now()
        self._wake: Alarm | None = None

    # --- the port ------------------------------------------------------------------------------

    def port_opened(self, port: OpenPort) -> None:
        """Ask from now on."""
        now = self.clock.now()
        self.link.attach(port, self.baud)
        self.schedule.port_opened(now)
        self.state = BusLink(at=self.clock.epoch(now), link="open")
        self._emit([self.state])
        self._go(now)

    def port_lost(self, cause: str) -> None:
        """Nothing can be asked; whatever was under way ends as unknown. Nothing is sent later."""
        now = self.clock.now()
        self._settle_last(self.link.detach(), now)
        self._routine = None
        self._closed_at = now
        updates: list[Update] = self.not_opened(cause)
        updates += self.roster.port_closed(self.clock.epoch(now), cause)
        self._emit(updates)
        for errand in self.errands:
            errand.close(now)
        self._sweep(now)
        self.lost(cause)

    def not_opened(self, cause: str) -> list[Update]:
        """The port is closed, and why; tells it when that is news."""
        if self.state.link == "closed" and self.state.cause == cause:
            return []
        self.state = BusLink(at=self.clock.epoch(self.clock.now()), link="closed", cause=cause)
        return [self.state]

    def tick(self) -> None:
        """Now and then: a line that fell silent may have come back at the rate it was given."""
        if self._expected_baud is None or not self.link.open or len(self.errands):
            return
        if len(self.schedule.round):
            if self.baud == self._expected_baud:
                self._expected_baud = None
            return
        now = self.clock.now()
        if now - self._tuned_at > LOOK_ELSEWHERE_S:
            self._look_elsewhere = True
            if not self.link.busy:
                self._go(now)

    def _turn_to_the_other_rate(self, now: float) -> None:
        """Between two questions, of which a silent line gets one after the other."""
        self._look_elsewhere = False
        if self._expected_baud is None:
            return
        other, self._expected_baud = self._expected_baud, self.baud
        self._retune(other)
        self.schedule.port_opened(now)

    def _retune(self, baud: int) -> None:
        """Everything from here on goes at ``baud``."""
        self._tuned_at = self.clock.now()
        try:
            self.link.retune(baud)
        except WireError as error:
            cause = str(error)
            self.clock.call_at(self._tuned_at, lambda: self.port_lost(cause))
        self.baud = baud

    def still_closed(self, cause: str) -> None:
        """Another try to open it failed."""
        now = self.clock.now()
        updates = self.not_opened(cause)
        if now - self._closed_at > CLOSED_TO_OFFLINE_S:
            updates += self.roster.port_stays_closed(self.clock.epoch(now), cause)
        self._emit(updates)

    # --- what people want ----------------------------------------------------------------------

    def watch(self, watch: Watch) -> None:
        """These units are on an open page."""
        self.schedule.watch(watch.units, anybody=bool(watch.units))

    def submit(self, errand: Errand) -> None:
        """Carry out ``errand``: its first frame is the next one, if its claim allows."""
        now = self.clock.now()
        self.errands.add(errand)
        if not self.link.open:
            errand.close(now)
            self._sweep(now)
        elif not self.link.busy:
            self._go(now)

    def cancel(self, command_id: str) -> None:
        """Give it up where nothing is half done."""
        self.errands.cancel(command_id)
        self._sweep(self.clock.now())

    def figures(self) -> BusFigures:
        """The figures of this moment."""
        now = self.clock.now()
        at = self.clock.epoch(now)
        figures = self._figures.take(now, at, self.link.counts, self.roster, self.schedule)
        return msgspec.structs.replace(figures, baud=self.baud)

    # --- one exchange after the other ----------------------------------------------------------

    def _heard(self, heard: Heard, began: float, ended: float) -> None:
        """An ordinary answer changes nothing about who is next, so it is taken in after the next has left."""
        self.trace.witness = None
        errand, self._owner = self._owner, None
        ordinary = errand is None and heard.reply is not None and heard.request.unit in self.schedule.round
        self._held = [] if ordinary else self._learn(heard, ended)
        if errand is not None:
            errand.settle(heard, ended)
            if errand.claim is Claim.SLOW:
                self.schedule.spent(Task(Kind.SLOW), began, ended, answered=True)
        elif self._routine is not None:
            self._settle_routine(heard, began, ended)
        if not self.link.busy:
            self._go(ended)
        told, self._held = self._held, None
        updates = [*self._learn(heard, ended), *told] if ordinary else told
        if updates:
            self._emit(updates)
        self._sweep(ended)

    def _learn(self, heard: Heard, now: float) -> list[Update]:
        request, reply = heard.request, heard.reply
        if request.unit == 0:
            return []
        if reply is None:
            updates = self.roster.missed(request.unit, self.clock.epoch(now))
            if self.roster[request.unit].silent and request.unit in self.schedule.round:
                self.schedule.fell_silent(request.unit, now)
            return updates
        assert heard.answered_at is not None
        updates = self.roster.heard(request, reply, heard.answered_at, heard.frame)
        if self.roster.is_configured(request.unit):
            self.schedule.answers(request.unit, now)
            if isinstance(request, WriteParameter) and not isinstance(reply, Nak):
                self.schedule.gaps.need(request.unit)
        return updates

    def _settle_last(self, heard: Heard | None, now: float) -> None:
        """The port broke while a request was on its way, or as it was handed over."""
        errand, self._owner = self._owner, None
        self.trace.witness = None
        if errand is None or errand.result is not None or self._sending is None:
            return
        errand.settle(heard or Heard(self._sending, None, self.clock.epoch(now)), now)

    def _settle_routine(self, heard: Heard, began: float, ended: float) -> None:
        assert self._routine is not None
        task, asking = self._routine
        asking.settle(heard)
        self.schedule.spent(task, began, ended, answered=heard.reply is not None)
        answer = asking.answer
        if answer is None:
            self.roster[task.unit].statistics.retries += 1
            return
        self._routine = None
        if task.kind is Kind.FIRST and answer.reply is None:
            self.schedule.fell_silent(task.unit, ended)
        if task.kind is Kind.PARAMETER and task.unit in self.schedule.round:
            if answer.reply is None:
                self.schedule.gaps.was_not_read(task.unit, task.number)
            else:
                available = not isinstance(answer.reply, Nak)
                self.schedule.gaps.was_read(task.unit, task.number, available=available)

    def _go(self, now: float) -> None:
        """Send what is next; nothing to send: be waked when there is."""
        if not self.link.open:
            return
        if self._look_elsewhere:
            self._turn_to_the_other_rate(now)
        starved = len(self.errands) > 0 and self._leave_a_poll(now)
        if starved and self._routine is None and (poll := self.schedule.next_poll()) is not None:
            self._routine = (poll, Asking(_ask_of(poll)))
        request = self._errands_request(now) if not starved else None
        if request is None:
            request = self._routine_request(now)
        if request is None:
            self._sleep(now)
            return
        self._send(request)

    def _send(self, request: Request) -> None:
        errand = self._owner
        self._sending = request
        self.trace.witness = errand.frames if errand is not None else None
        asking = errand.asking if errand is not None else None
        try:
            self.link.send(request, asking.dialect_of(request) if asking is not None else None)
        except PartlySent as error:
            self.port_lost(str(error))
        except WireError as error:
            self._sending = None
            self.port_lost(str(error))
        except CallerError as error:
            self._owner = None
            if errand is None:
                raise
            errand.end(Result(id="", at=0.0, outcome="invalid", message=str(error)))
            self._go(self.clock.now())
        else:
            if errand is not None and asking is not None and asking.tells_of(request):
                self.note(errand.id, Tell("sent", request.unit))

    def _errands_request(self, now: float, *, slow: bool = False) -> Request | None:
        chosen = self.errands.next_request(now, self.link.doubt, slow=slow)
        if chosen is None:
            return None
        self._owner, request = chosen
        return request

    def _leave_a_poll(self, now: float) -> bool:
        return (
            not self.errands.whole_line_changes
            and now - self._routine_at > ERRANDS_AT_A_STRETCH_S
            and len(self.schedule.round) > 0
        )

    def _routine_request(self, now: float) -> Request | None:
        if now < self._not_before:
            return None
        slow_waits = self.errands.slow_waits
        while self._routine is None:
            task = self.schedule.next(now, slow_waits=slow_waits)
            if task is None:
                return None
            if task.kind is not Kind.SLOW:
                self._routine = (task, Asking(_ask_of(task)))
                break
            request = self._errands_request(now, slow=True)
            if request is not None:
                self._pace(request, now)
                return request
            slow_waits = False
        task, asking = self._routine
        request = asking.next_request(now, self.link.doubt(task.unit))
        assert request is not None
        self._pace(request, now)
        return request

    def _pace(self, request: Request, now: float) -> None:
        self._routine_at = now
        self._not_before = now + PACE * self._exchange_s(request)

    def _exchange_s(self, request: Request) -> float:
        return wire_seconds(7 + usual_reply_bytes(request, self.bus), self.baud)

    def _poll_s(self) -> float:
        return self._exchange_s(ReadStatus(1))

    # --- waiting and telling -------------------------------------------------------------------

    def _sleep(self, now: float) -> None:
        moments = [self.schedule.wake_at(), self._not_before, *self.errands.moments()]
        ahead = [moment for moment in moments if moment is not None and now < moment < float("inf")]
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
        """Tell the fate of every errand that has one."""
        for errand in self.errands.take_finished():
            self._emit([self._fate(errand, now)])

    def _fate(self, errand: Errand, now: float) -> Result:
        assert errand.result is not None
        interpreter = Interpreter(self.bus.dialect)
        frames = [interpreter.frame(passed) for passed in errand.frames]
        at = self.clock.epoch(now)
        return msgspec.structs.replace(errand.result, id=errand.id, at=at, frames=frames)

    def note(self, command_id: str, step: Note) -> None:
        """What a procedure tells on its way."""
        at = self.clock.epoch(self.clock.now())
        match step:
            case Tell():
                self._tell([Progress(command_id, at, step.stage, step.unit, step.done, step.of)])
            case Unstage():
                self._tell(self.roster.unstage(step.unit, at))
            case Retune(baud=baud):
                self._retune(baud)
            case Expect(baud=baud):
                self._expected_baud = baud

    def _tell(self, updates: list[Update]) -> None:
        """In the order of happening, but after the next request has left."""
        if self._held is not None:
            self._held += updates
        elif updates:
            self._emit(updates)


def _ask_of(task: Task) -> Ask:
    tries = _TRIES.get(task.kind, 0)
    if task.kind is Kind.PARAMETER:
        return Ask(ReadParameter(task.unit, task.number), most_tries=tries)
    return Ask(ReadStatus(task.unit), most_tries=tries)
