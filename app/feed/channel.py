"""The way down to one bus: commands by id, each with exactly one fate.

The worker carries out an id once and repeats its fate when asked again; so what was under way
when the connection broke is asked again of the *same* worker, and is unverified with any other.

A worker tells its figures every second, so one that is silent past a command's deadline is stuck, and
whoever waits is told so at once: it drops what comes to it late by its own look at the deadline.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from app.feed.plausibility import result_for
from app.live.state.bus_live import NO_WORKER
from bus.contract import AppMessage, Cancel, Command, Outcome, Progress, ReserveTurn, Result, Watch
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message

REASK_WITHIN_S = 10.0
"""How long a command under way waits for its worker to come back."""
PATIENCE_S = 15.0
"""How long after its deadline, or its last sign of progress, a worker that lives is still waited for."""
LOOK_S = 0.25
SILENT_LOOKS = 8
"""After so many looks without a word from a connected worker it is stuck: two seconds, twice its figures'.
Looks are counted, not seconds, so that a stall of the app itself makes nobody look silent."""
AWAY_LOOKS = 20
"""The same for one whose connection broke, which may need a moment to come back."""

ProgressListener = Callable[[Progress], None]


class MessageSink(Protocol):
    """What the channel needs of a worker's WebSocket."""

    async def send(self, message: AppMessage) -> None:
        """Raises ConnectionError when the worker is gone."""


@dataclass(slots=True)
class _OpenCommand:
    command: Command
    worker: str
    fate: asyncio.Future[Result]
    due_at: Monotonic
    """Its deadline, on the monotonic clock like ``give_up_at``."""
    give_up_at: Monotonic
    listener: ProgressListener | None
    sent_to: MessageSink | None = None
    """Only what this connection reports of it counts."""


class Channel:
    """Commands and wishes for one bus, over whichever connection its worker has now."""

    def __init__(self, *, patience_s: float = PATIENCE_S, reask_s: float = REASK_WITHIN_S) -> None:
        self._patience_s = patience_s
        self._reask_s = reask_s
        self._connection: MessageSink | None = None
        self._worker = ""
        self._words = 0
        self._asked: dict[str, _OpenCommand] = {}
        self._watch = Watch(units=[])

    @property
    def connected(self) -> bool:
        """Whether a worker is there to ask."""
        return self._connection is not None

    async def opened(self, connection: MessageSink, worker: str) -> None:
        """A worker is ready: tell it what is watched, ask again what was under way."""
        self._connection, self._worker = connection, worker
        if self._watch.units or self._watch.trace:
            await self._send(self._watch)
        for asked in tuple(self._asked.values()):
            if asked.worker != worker:
                _end(asked, "unverified", Message("worker_restarted"))
            else:
                asked.give_up_at = self._last_moment(asked.command)
                await self._send_command(asked)

    def closed(self, connection: MessageSink) -> None:
        """The connection ended. What is under way waits a while for the worker's return."""
        if self._connection is not connection:
            return
        self._connection = None
        for asked in self._asked.values():
            asked.give_up_at = min(asked.give_up_at, monotonic_now() + self._reask_s)

    def on_message(self) -> None:
        """Any message shows that the worker lives."""
        self._words += 1

    async def ask(self, command: Command, listener: ProgressListener | None = None) -> Result:
        """Send ``command`` and wait for its fate. Never raises for what happens on the way."""
        if self._connection is None:
            return Result(id=command.id, at=unix_now(), outcome="bus_closed", message=NO_WORKER)
        fate: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        asked = _OpenCommand(
            command, self._worker, fate, _due_at(command), self._last_moment(command), listener
        )
        self._asked[command.id] = asked
        try:
            await self._send_command(asked)
            return await self._fate_of(asked)
        finally:
            del self._asked[command.id]

    async def reserve(self) -> None:
        """Say that a write is about to be asked for: the wire waits a moment for it."""
        await self._send(ReserveTurn())

    async def cancel(self, command_id: str) -> None:
        """Ask the worker to give a command up where nothing is half done; its fate still comes."""
        if command_id in self._asked:
            await self._send(Cancel(id=command_id))

    async def watch(self, units: list[int], *, trace: bool = False) -> None:
        """Say which units are on an open page and whether someone follows the trace."""
        wanted = Watch(units=sorted(units), trace=trace)
        if wanted != self._watch:
            self._watch = wanted
            await self._send(wanted)

    def on_update(self, update: Result | Progress, connection: MessageSink) -> None:
        """Take in the result or progress of a command. It counts only from the connection that the command
        went to; an unknown id belongs to a command that has ended."""
        asked = self._asked.get(update.id)
        if asked is None or asked.fate.done() or asked.sent_to is not connection:
            return
        if isinstance(update, Result):
            asked.fate.set_result(result_for(update, asked.command.action))
            return
        asked.give_up_at = max(asked.give_up_at, monotonic_now() + self._patience_s)
        if asked.listener is not None:
            asked.listener(update)

    def _last_moment(self, command: Command) -> Monotonic:
        return _due_at(command) + self._patience_s

    async def _send_command(self, asked: _OpenCommand) -> None:
        asked.sent_to = self._connection
        await self._send(asked.command)

    async def _send(self, message: AppMessage) -> None:
        connection = self._connection
        if connection is None:
            return
        try:
            await connection.send(message)
        except ConnectionError:
            self.closed(connection)

    async def _fate_of(self, asked: _OpenCommand) -> Result:
        words, silent_looks = self._words, 0
        while (left := self._time_left(asked, silent_looks)) > 0 and not asked.fate.done():
            await asyncio.wait({asked.fate}, timeout=min(left, LOOK_S))
            silent_looks = silent_looks + 1 if self._words == words else 0
            words = self._words
        if not asked.fate.done():
            _end(asked, "unverified", self._why_no_fate(silent_looks))
        return asked.fate.result()

    def _time_left(self, asked: _OpenCommand, silent_looks: int) -> float:
        """Seconds for which its fate is still waited for, as things are now."""
        stuck = silent_looks >= (SILENT_LOOKS if self.connected else AWAY_LOOKS)
        return (min(asked.due_at, asked.give_up_at) if stuck else asked.give_up_at) - monotonic_now()

    def _why_no_fate(self, silent_looks: int) -> Message:
        if not self.connected:
            return Message("worker_lost")
        if silent_looks >= SILENT_LOOKS:
            return Message("worker_no_response")
        return Message("worker_no_result")


def _due_at(command: Command) -> Monotonic:
    return monotonic_now() + max(0.0, command.deadline - unix_now())


def _end(asked: _OpenCommand, outcome: Outcome, message: Message) -> None:
    if not asked.fate.done():
        asked.fate.set_result(Result(id=asked.command.id, at=unix_now(), outcome=outcome, message=message))
