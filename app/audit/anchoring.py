"""Exports the head of the audit log to the anchor every minute, and reports when the log was altered."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import structlog

from app.audit.anchor import AnchorError, anchor_line, append_line, newest_anchor
from app.audit.chain import Head
from app.audit.log import EventLog
from app.audit.walk import not_anchored
from app.errors import StoreError
from app.web.formats import Formats
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message

EVERY_S = 60.0
WITHIN_S = 10.0
"""What the medium is given for one line, which on a network may be long."""
AT_END_S = 1.0
"""The same while the server ends, which has five seconds in total."""
T = TypeVar("T")
log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class AnchorStatus:
    """``altered``: how the log differs from the anchor, which is reported until the server starts again;
    ``unwritten``: why the anchor is behind, ``since`` when (Unix time in seconds). Both mostly None."""

    altered: Message | None = None
    unwritten: Message | None = None
    since: UnixTime = UnixTime(0.0)


class Anchoring:
    """Exports the head of ``events`` to a file. Never raises for what the medium does."""

    def __init__(self, events: EventLog, path: Path, clock: Clock = unix_now) -> None:
        self.status = AnchorStatus()
        self._events = events
        self._path = path
        self._clock = clock
        self._exported: Head | None = None
        self._one_at_a_time = asyncio.Lock()
        self._thread = Detached("audit-anchor")

    async def follow(self) -> None:
        """Export every minute, without end."""
        while True:
            await self.export()
            await asyncio.sleep(EVERY_S)

    async def end(self) -> None:
        """Write the head of the log as the server leaves it, where the medium is quick."""
        with suppress(TimeoutError):
            async with asyncio.timeout(AT_END_S):
                await self.export(AT_END_S)

    async def export(self, within_s: float = WITHIN_S) -> None:
        """Write the head where it has changed. A failure is an event and :attr:`status`, and is retried."""
        async with self._one_at_a_time:
            try:
                await self._export(within_s)
            except AnchorError as error:
                await self._failed(error.reason)
            except StoreError as error:
                log.error("audit log not anchored", why=str(error))

    async def _export(self, within_s: float) -> None:
        if self._exported is None:
            self._exported = await self._begin(within_s)
        head, _ = await self._events.proof.extent()
        if self.status.altered or (head.id, head.hash) == (self._exported.id, self._exported.hash):
            return
        verdict = await self._events.proof.since(self._exported)
        if verdict.fault is not None:
            await self._found_altered(verdict.fault)
            return
        line = anchor_line(head, self._clock(), self._events.keys.ring)
        await self._in_thread(lambda: append_line(self._path, line), within_s)
        self._exported = head
        if self.status.unwritten:
            self.status = AnchorStatus(self.status.altered)
            await self._record(Message("event_anchor_written"))

    async def _begin(self, within_s: float) -> Head:
        """The head that the anchor names last, as the log has it; a difference is reported."""
        ring = self._events.keys.ring
        anchored = await self._in_thread(lambda: newest_anchor(self._path, ring), within_s)
        if anchored is None:
            return Head()
        there = await self._events.proof.link(anchored.id)
        if there is None or there.hash != anchored.hash:
            await self._found_altered(not_anchored(anchored.id))
            return anchored
        return there

    async def _found_altered(self, fault: Message) -> None:
        self.status = AnchorStatus(fault, self.status.unwritten, self.status.since)
        log.error("audit log altered", why=str(fault))
        await self._record(Message("event_audit_altered"), Message("audit_verify_names_entry"))

    async def _failed(self, reason: Message) -> None:
        if self.status.unwritten:
            return
        self.status = AnchorStatus(self.status.altered, reason, self._clock())
        log.error("audit anchor not written", path=str(self._path), why=str(reason))
        await self._record(Message("event_anchor_not_written"), reason)

    async def _record(self, what: Message, message: Message | str = "") -> None:
        with suppress(StoreError):
            await self._events.record(kind="audit", what=what, message=message)

    async def _in_thread(self, work: Callable[[], T], within_s: float) -> T:
        try:
            return await self._thread.run(work, within_s)
        except TimeoutError as error:
            raise AnchorError(self._path, Message("anchor_no_response")) from error


class Detached:
    """Runs one task at a time in a separate thread. An executor would be joined at the end of the
    process, and a network file system that hangs would keep that from ending."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._running: Future[Any] = Future()
        self._running.set_result(None)

    async def run(self, work: Callable[[], T], within_s: float) -> T:
        """The result of ``work``, or what it raises. Raises TimeoutError when it takes longer; also when
        earlier work still does, and then nothing was begun."""
        async with asyncio.timeout(within_s):
            if not self._running.done():
                with suppress(Exception):
                    await asyncio.wrap_future(self._running)
            self._running = started = self._start(work)
            return await asyncio.wrap_future(started)

    def _start(self, work: Callable[[], T]) -> Future[T]:
        future: Future[T] = Future()
        # From here on it cannot be canceled: the thread runs to its end.
        future.set_running_or_notify_cancel()

        def run() -> None:
            try:
                future.set_result(work())
            except Exception as error:
                future.set_exception(error)

        threading.Thread(target=run, name=self._name, daemon=True).start()
        return future


def status_of(anchoring: Anchoring | None) -> AnchorStatus:
    """How well the log is anchored; without an anchor, there is no fault."""
    return AnchorStatus() if anchoring is None else anchoring.status


def anchor_notice(status: AnchorStatus, formats: Formats, now: UnixTime) -> Message | None:
    """None while the log is anchored and intact. ``now``: Unix time in seconds."""
    if status.altered is not None:
        return Message("audit_altered_after_anchor")
    if status.unwritten is not None:
        since = formats.since(status.since, now)
        return Message.of("audit_anchor_missed", time=since, reason=status.unwritten)
    return None
