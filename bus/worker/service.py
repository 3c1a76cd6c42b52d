"""A bus worker: the line, the link to the app, and the messages between them."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import uuid
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.metadata import version

import msgspec
import structlog
import uvloop

from bus.contract import (
    CONTRACT_VERSION,
    BusLink,
    Command,
    Hello,
    Outcome,
    ReadTrace,
    Result,
    Snapshot,
    UnitLink,
    Update,
    Watch,
    WireAction,
)
from bus.contract.session import ClockOffset
from bus.instants import UnixTime
from bus.line.commands.catalogue import command_run_of
from bus.line.commands.procedure import ReportProgress
from bus.line.line_loop import LineLoop
from bus.line.opener import Opener, OpenFunction, open_port
from bus.line.timing import LineClock, RealClock
from bus.messages import Message, in_english
from bus.settings import BusSettings
from bus.worker.outbox import Outbox, TraceReports
from bus.worker.process import configure_log, named_parent, tie_to
from bus.worker.uplink import Uplink, UplinkTls, is_encrypted

MAX_RESULTS = 2_000
MAX_COMMANDS = 300
"""The most commands at once, far more than people and programs request, so that a faulty app cannot fill the
memory."""
FIGURES_S = 1.0
FINISH_WITHIN_S = 1.4
"""The seconds that a change in flight may take once the worker has to leave."""
DELIVER_WITHIN_S = 0.3
LOOK_S = 0.01

_log = structlog.get_logger("bus.worker")


class BusWorker:
    """The worker of one bus: ``run`` it until cancelled, and call ``finish`` first for an orderly end."""

    def __init__(
        self,
        bus: BusSettings,
        clock: LineClock | None = None,
        open_function: OpenFunction = open_port,
        seed: int | None = None,
    ) -> None:
        self.bus = bus
        self.clock = clock or RealClock()
        self.worker = uuid.uuid4().hex
        self.outbox = Outbox()
        self.app_clock = ClockOffset()
        seed = seed if seed is not None else uuid.uuid4().int
        self.line = LineLoop(bus, self.clock, self._emit, seed)
        self._opener = Opener(self.line, open_function)
        self._started_at = self._epoch()
        self._figures = self.line.figures()
        self._results: OrderedDict[str, Result | None] = OrderedDict()
        self._traces = TraceReports(self.line.trace, bus.dialect, self._emit, self._epoch)
        self._leaving = False
        self._was_linked = False

    async def run(self) -> None:
        """Run the line and its figures; the caller runs the uplink beside it."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._opener.run())
            tasks.create_task(self._report_figures())

    async def finish(self) -> None:
        """Accept no new command; let those under way end or be withdrawn, within ``FINISH_WITHIN_S``."""
        self._leaving = True
        for run in self.line.commands:
            self.line.cancel(run.id)
        await _wait_while(lambda: len(self.line.commands) > 0, FINISH_WITHIN_S)
        await _wait_while(lambda: self.outbox.connected and len(self.outbox) > 0, DELIVER_WITHIN_S)

    # --- calls of the uplink -------------------------------------------------------------------

    def hello(self) -> Hello:
        return Hello(
            version=CONTRACT_VERSION,
            bus=self.bus.name,
            worker=self.worker,
            started_at=self._started_at,
            software=f"lineside {version('lineside')}",
            port=self.bus.port,
            sent_at=self._epoch(),
        )

    def note_held(self, units: Sequence[int]) -> None:
        """Note at the first link, before any command, that it is unknown what these units would execute. A
        later app knows less than this worker."""
        if not self._was_linked:
            self._was_linked = True
            self.line.roster.note_held(units, self._epoch())

    def snapshot(self, seq: int) -> Snapshot:
        return Snapshot(
            seq=seq,
            sent_at=self._epoch(),
            bus=self.line.state,
            units=self.line.roster.states(),
            figures=self._figures,
            app_behind_s=self.app_clock.seconds,
        )

    def watch(self, watch: Watch) -> None:
        self.line.schedule.watch(watch.units)
        self._traces.follow(wanted=watch.trace)

    def reserve(self) -> None:
        self.line.reserve()

    def cancel(self, command_id: str) -> None:
        self.line.cancel(command_id)

    def command(self, command: Command) -> None:
        """Carry out a command once: a second request with its id returns the same result."""
        if isinstance(command.action, ReadTrace):
            self._traces.read(command.id, command.action)
            return
        if command.id in self._results:
            known = self._results[command.id]
            if known is not None:
                self.outbox.put([known])
            return
        self._remember(command.id, None)
        self._begin(command, command.action)

    # --- commands ------------------------------------------------------------------------------

    def _begin(self, command: Command, action: WireAction) -> None:
        now, command_id = self.clock.now(), command.id
        deadline = now + (self.app_clock.here(command.deadline) - self.clock.epoch(now))
        refusal = self._refusal(action, deadline - now)
        if refusal is not None:
            self._emit([Result(command_id, self._epoch(), *refusal)])
            return
        kind = type(action).__name__
        _log.info("command", id=command_id, action=kind, time_left_s=round(deadline - now, 3))
        # This is reported with the next exchange, which mostly is the command's own.
        self.line.apply(command_id, ReportProgress("waiting"))
        run = command_run_of(self.line, command_id, action, deadline, command.scales, typed=command.typed)
        self.line.submit(run)

    def _refusal(self, action: WireAction, time_left_s: float) -> tuple[Outcome, Message] | None:
        """Return the outcome and reason if ``action`` can be refused at once, else None."""
        if self._leaving:
            return "not_sent", Message("worker_stopping")
        if len(self.line.commands) >= MAX_COMMANDS:
            return "not_sent", Message("too_many_commands")
        if not self.line.link.open:
            return "bus_closed", self.line.state.refusal
        if action.writes and not action.stops and self.line.link.second_master.is_present(self.clock.now()):
            return "not_sent", Message("second_master_writes")
        if time_left_s < 0 and action.writes:
            return "not_sent", Message.of("arrived_late", seconds=round(-time_left_s, 1))
        return None

    def _remember(self, command_id: str, result: Result | None) -> None:
        self._results[command_id] = result
        while len(self._results) > MAX_RESULTS:
            self._results.popitem(last=False)

    # --- reports -------------------------------------------------------------------------------

    def _emit(self, updates: list[Update]) -> None:
        for update in updates:
            if isinstance(update, Result):
                if update.id in self._results:
                    self._remember(update.id, msgspec.structs.replace(update, frames=[]))
                _log.info(
                    "command result", id=update.id, outcome=update.outcome, message=in_english(update.message)
                )
            elif isinstance(update, UnitLink):
                _log.info("unit", unit=update.unit, link=update.link, cause=in_english(update.cause))
            elif isinstance(update, BusLink):
                _log.debug("bus", link=update.link, cause=in_english(update.cause))
        self.outbox.put(updates)

    async def _report_figures(self) -> None:
        while True:
            await asyncio.sleep(FIGURES_S)
            self.clock.settle()
            figures = self.line.figures()
            self._figures = msgspec.structs.replace(figures, updates_lost=self.outbox.lost)
            self.outbox.put([self._figures])

    def _epoch(self) -> UnixTime:
        return self.clock.epoch(self.clock.now())


async def _wait_while(holds: Callable[[], bool], most_s: float) -> None:
    for _ in range(int(most_s / LOOK_S)):
        if not holds():
            return
        await asyncio.sleep(LOOK_S)


async def run_worker(
    bus: BusSettings,
    apps: Sequence[str],
    token: str,
    *,
    leave: asyncio.Event | None = None,
    tls: UplinkTls | None = None,
) -> None:
    """Poll ``bus`` and report to the first of the addresses ``apps`` that accepts the worker, until ``leave``
    is set (by default indefinitely). ``tls``: the files for addresses that begin with https; by default this
    machine's authorities. On leaving, a change in flight is finished or withdrawn first; that takes less than
    two seconds."""
    worker = BusWorker(bus)
    if tls is None and any(map(is_encrypted, apps)):
        tls = UplinkTls()
    uplink = Uplink(apps, token, worker.outbox, worker, worker.app_clock, worker._epoch, tls)
    tasks = [asyncio.create_task(worker.run()), asyncio.create_task(uplink.run())]
    leaving = asyncio.create_task((leave or asyncio.Event()).wait())
    try:
        await asyncio.wait([*tasks, leaving], return_when=asyncio.FIRST_COMPLETED)
        if leaving.done():
            await worker.finish()
    finally:
        for task in (*tasks, leaving):
            task.cancel()
        for ended in await asyncio.gather(*tasks, return_exceptions=True):
            if isinstance(ended, Exception):
                raise ended


PRIORITY = -10
"""The niceness: the worker sleeps 97 % of the time, but must send as soon as a response is complete."""


def run(
    bus: BusSettings,
    apps: Sequence[str],
    token: str,
    *,
    child: bool = False,
    tls: UplinkTls | None = None,
) -> int:
    """Run one worker until SIGTERM or SIGINT, a ``child`` also until its parent ends; return 0."""
    configure_log()
    if child:
        tie_to(named_parent() or os.getppid())
    # A busy machine must not leave the wire idle: run before others if the system allows it, and keep what is
    # loaded out of every garbage collection.
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    gc.collect()
    gc.freeze()
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(_until_stopped(bus, apps, token, tls))
    return 0


async def _until_stopped(bus: BusSettings, apps: Sequence[str], token: str, tls: UplinkTls | None) -> None:
    leave = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, leave.set)
    await run_worker(bus, apps, token, leave=leave, tls=tls)
