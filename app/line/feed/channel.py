"""The commands of one bus on their way to the worker, by id, each with exactly one result.

The worker carries out an id once and repeats its result when it gets the id again. A command in progress when
the connection breaks is sent again to the *same* worker, and is unverified with any other.

A worker reports its figures every second: one without a message past a command's deadline is stuck, and the
command ends at once. The worker drops a late command by its own check of the deadline.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Protocol

from app.line.feed.plausibility import result_for
from app.line.live.bus_live import NO_WORKER
from bus.contract import AppMessage, Cancel, Command, Outcome, Progress, ReserveTurn, Result, Watch
from bus.instants import Monotonic, monotonic_now, unix_now
from bus.messages import Message

REASK_WITHIN_S = 10.0
"""The seconds for which a command under way waits for its worker to return."""
PATIENCE_S = 15.0
"""The seconds after its deadline, or its last progress, for which a command waits for a live worker."""
LOOK_S = 0.25
STUCK_AFTER_LOOKS = 8
"""The checks without a message after which a connected worker counts as stuck: two seconds, twice its period.
Checks are counted, not seconds, so that a stall of the app does not count as a stall of the worker."""
AWAY_LOOKS = 20
"""The same for a worker whose connection broke, which may need a moment to return."""


class MessageSink(Protocol):
    """The part of a worker's WebSocket that the channel uses."""

    async def send(self, message: AppMessage) -> None:
        """Send one message. Raise ConnectionError if the worker is gone."""


@dataclass(slots=True)
class _OpenCommand:
    command: Command
    worker: str
    result: asyncio.Future[Result]
    due_at: Monotonic
    """The deadline, on the monotonic clock like ``give_up_at``."""
    give_up_at: Monotonic
    sent_to: MessageSink | None = None
    """The only connection whose reports about the command count."""


class Channel:
    """The channel that sends commands to one bus over the current connection of its worker."""

    def __init__(self, *, patience_s: float = PATIENCE_S, reask_s: float = REASK_WITHIN_S) -> None:
        self._patience_s = patience_s
        self._reask_s = reask_s
        self._connection: MessageSink | None = None
        self._worker = ""
        self._words = 0
        self._open: dict[str, _OpenCommand] = {}
        self._watch = Watch(units=[])

    @property
    def connected(self) -> bool:
        return self._connection is not None

    async def opened(self, connection: MessageSink, worker: str) -> None:
        """Send a worker that is ready the watched units and the open commands."""
        self._connection, self._worker = connection, worker
        if self._watch.units or self._watch.trace:
            await self._deliver(self._watch)
        for open_command in tuple(self._open.values()):
            if open_command.worker != worker:
                _end(open_command, "unverified", Message("worker_restarted"))
            else:
                open_command.give_up_at = self._last_moment(open_command.command)
                await self._send_command(open_command)

    def closed(self, connection: MessageSink) -> None:
        """Note that the connection ended; open commands wait a while for the worker's return."""
        if self._connection is not connection:
            return
        self._connection = None
        for open_command in self._open.values():
            open_command.give_up_at = min(open_command.give_up_at, monotonic_now() + self._reask_s)

    def on_message(self) -> None:
        """Note that the worker is alive, as any message shows."""
        self._words += 1

    async def send(self, command: Command) -> Result:
        """Send ``command`` and wait for its result. A failure on the way is a result, never an exception."""
        if self._connection is None:
            return Result(id=command.id, at=unix_now(), outcome="bus_closed", message=NO_WORKER)
        result: asyncio.Future[Result] = asyncio.get_running_loop().create_future()
        open_command = _OpenCommand(
            command, self._worker, result, _due_at(command), self._last_moment(command)
        )
        self._open[command.id] = open_command
        try:
            await self._send_command(open_command)
            return await self._result_of(open_command)
        finally:
            del self._open[command.id]

    async def reserve(self) -> None:
        """Announce a write, for which the wire is kept free for a moment."""
        await self._deliver(ReserveTurn())

    async def cancel(self, command_id: str) -> None:
        """Ask the worker to end a command where nothing is half done; its result still arrives."""
        if command_id in self._open:
            await self._deliver(Cancel(id=command_id))

    async def watch(self, units: list[int], *, trace: bool = False) -> None:
        """Send which units are on an open page and whether the trace is followed."""
        wanted = Watch(units=sorted(units), trace=trace)
        if wanted != self._watch:
            self._watch = wanted
            await self._deliver(wanted)

    def awaits(self, id: str) -> bool:
        """Return whether the result of this command is still to come."""
        return id in self._open and not self._open[id].result.done()

    def on_update(self, update: Result | Progress, connection: MessageSink) -> None:
        """Take the result or progress of a command. It counts only from the connection that the command went
        to; an unknown id belongs to a command that has ended."""
        open_command = self._open.get(update.id)
        if open_command is None or open_command.result.done() or open_command.sent_to is not connection:
            return
        if isinstance(update, Result):
            open_command.result.set_result(result_for(update, open_command.command.action))
            return
        open_command.give_up_at = max(open_command.give_up_at, monotonic_now() + self._patience_s)

    def _last_moment(self, command: Command) -> Monotonic:
        return _due_at(command) + self._patience_s

    async def _send_command(self, open_command: _OpenCommand) -> None:
        open_command.sent_to = self._connection
        await self._deliver(open_command.command)

    async def _deliver(self, message: AppMessage) -> None:
        connection = self._connection
        if connection is None:
            return
        try:
            await connection.send(message)
        except ConnectionError:
            self.closed(connection)

    async def _result_of(self, open_command: _OpenCommand) -> Result:
        words, missed_looks = self._words, 0
        while (left := self._time_left(open_command, missed_looks)) > 0 and not open_command.result.done():
            await asyncio.wait({open_command.result}, timeout=min(left, LOOK_S))
            missed_looks = missed_looks + 1 if self._words == words else 0
            words = self._words
        if not open_command.result.done():
            _end(open_command, "unverified", self._why_no_result(missed_looks))
        return open_command.result.result()

    def _time_left(self, open_command: _OpenCommand, missed_looks: int) -> float:
        """Return the seconds for which the result is still awaited."""
        stuck = missed_looks >= (STUCK_AFTER_LOOKS if self.connected else AWAY_LOOKS)
        return (
            min(open_command.due_at, open_command.give_up_at) if stuck else open_command.give_up_at
        ) - monotonic_now()

    def _why_no_result(self, missed_looks: int) -> Message:
        if not self.connected:
            return Message("worker_lost")
        if missed_looks >= STUCK_AFTER_LOOKS:
            return Message("worker_no_response")
        return Message("worker_no_result")


def is_reported(result: Result) -> bool:
    """Return whether a worker has reported how a command ended: it names the frames that it has sent."""
    return result.outcome != "unverified" or bool(result.frames)


def _due_at(command: Command) -> Monotonic:
    return monotonic_now() + max(0.0, command.deadline - unix_now())


def _end(open_command: _OpenCommand, outcome: Outcome, message: Message) -> None:
    if not open_command.result.done():
        open_command.result.set_result(
            Result(id=open_command.command.id, at=unix_now(), outcome=outcome, message=message)
        )
