"""Exports the heads of the audit log to the anchor every minute, and reports when the log was altered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import structlog

from app.audit.log import EventLog
from app.audit.proof.anchor import (
    FULL_EVERY_BYTES,
    AnchorError,
    anchor_line,
    append_line,
    is_of_lost_key,
    key_anchor_of,
    newest_anchor,
    put_aside,
    replace_line,
)
from app.audit.proof.chain import Head
from app.audit.proof.keyring import KeyRing
from app.audit.proof.walk import cut_off, not_anchored
from app.errors import StoreError
from app.server.in_thread import in_thread
from app.web.rendering.formats import Formats
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message, joined

EVERY_S = 60.0
WITHIN_S = 10.0
"""Time that the medium has for one line, which on a network may be long."""
AT_END_S = 1.0
"""Time that it has while the server ends, which takes five seconds in total."""
T = TypeVar("T")
log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class AnchorStatus:
    """``altered``: how the log differs from the anchor, which is reported until the server starts again;
    ``unwritten``: why the anchor is behind, ``since`` when (Unix time in seconds). Both mostly None."""

    altered: Message | None = None
    unwritten: Message | None = None
    since: UnixTime = UnixTime(0.0)


class _AnchorPlace:
    """A file of anchors, and the heads that it has; ``is_single``: in its newest line alone. One that is not
    configured is not missed: that it cannot be written is an event, and no more."""

    def __init__(self, path: Path, *, is_configured: bool = False, is_single: bool = False) -> None:
        self.path = path
        self.is_configured = is_configured
        self.is_single = is_single
        self.exported: dict[str, Head] | None = None
        self.is_failing = False
        self._bytes_since_full = FULL_EVERY_BYTES
        self._work: asyncio.Future[Any] | None = None

    def write(self, heads: dict[str, Head], at: UnixTime, ring: KeyRing) -> None:
        """Add a line with the heads that have changed, or with all from time to time; on disk when this
        returns. Raises AnchorError."""
        if self.is_single:
            replace_line(self.path, anchor_line(heads, at, ring))
            return
        is_full = self._bytes_since_full >= FULL_EVERY_BYTES
        line = anchor_line(heads if is_full else changed(self.exported or {}, heads), at, ring)
        append_line(self.path, line)
        self._bytes_since_full = len(line) + (0 if is_full else self._bytes_since_full)

    async def in_thread(self, work: Callable[[], T], within_s: float) -> T:
        """Run ``work`` once earlier work of this place has ended: a network file system may hang. Raises
        AnchorError where that takes longer."""
        try:
            async with asyncio.timeout(within_s):
                if self._work is not None:
                    await asyncio.wait([self._work])
                self._work = started = asyncio.ensure_future(in_thread(work))
                return await asyncio.shield(started)
        except TimeoutError as error:
            raise AnchorError(self.path, Message("anchor_no_response")) from error


class Anchoring:
    """Exports the heads of ``events`` to the file ``path`` and to the anchor beside the key, after it is in
    the store: the log may be ahead of an anchor, never behind. Never raises for what the media do.

    ``is_configured`` False: the file is in its default place.
    """

    def __init__(
        self, events: EventLog, path: Path, clock: Clock = unix_now, *, is_configured: bool = True
    ) -> None:
        self.status = AnchorStatus()
        self._events = events
        self._clock = clock
        self._places = [_AnchorPlace(path, is_configured=is_configured)]
        if events.keys.path is not None:
            self._places.append(_AnchorPlace(key_anchor_of(events.keys.path), is_single=True))
        self._one_at_a_time = asyncio.Lock()

    async def follow(self) -> None:
        """Export every minute, without end."""
        while True:
            await self.export()
            await asyncio.sleep(EVERY_S)

    async def end(self) -> None:
        """Write the heads of the log as the server leaves it, where the medium is quick."""
        with suppress(TimeoutError):
            async with asyncio.timeout(AT_END_S):
                await self.export(AT_END_S)

    async def export(self, within_s: float = WITHIN_S) -> None:
        """Write the heads that have changed. A failure is an event and :attr:`status`, and is retried."""
        async with self._one_at_a_time:
            await asyncio.gather(*(self._export_to(place, within_s) for place in self._places))

    async def _export_to(self, place: _AnchorPlace, within_s: float) -> None:
        try:
            await self._export(place, within_s)
        except AnchorError as error:
            await self._failed(place, error.reason)
        except StoreError as error:
            log.error("audit log not anchored", why=str(error))

    async def _export(self, place: _AnchorPlace, within_s: float) -> None:
        if place.exported is None:
            place.exported = await self._begin(place, within_s)
        heads, _ = await self._events.proof.extent()
        if self.status.altered or not changed(place.exported, heads):
            return
        verdict = await self._events.proof.since(place.exported)
        if verdict.fault is not None:
            await self._found_altered(verdict.fault)
            return
        now, ring = self._clock(), self._events.keys.ring
        await place.in_thread(lambda: place.write(heads, now, ring), within_s)
        place.exported = heads
        if place.is_failing:
            place.is_failing = False
            if place.is_configured:
                self.status = AnchorStatus(self.status.altered)
            await self._record(Message("event_anchor_written"))

    async def _begin(self, place: _AnchorPlace, within_s: float) -> dict[str, Head]:
        """The heads that the anchor names last, as the log has them; a difference is reported."""
        ring = self._events.keys.ring
        anchored = await place.in_thread(lambda: _present_anchor(place, ring), within_s)
        there = await self._events.proof.links(anchored)
        for chain, head in anchored.items():
            if chain not in there:
                await self._found_altered(cut_off(head.id, str(place.path)))
                return anchored
            if there[chain].id == head.id and there[chain].hash != head.hash:
                await self._found_altered(not_anchored(head.id))
                return anchored
        return there

    async def _found_altered(self, fault: Message) -> None:
        if self.status.altered:
            return
        self.status = AnchorStatus(fault, self.status.unwritten, self.status.since)
        log.error("audit log altered", why=str(fault))
        verify = Message("audit_verify_names_entry")
        await self._record(Message("event_audit_altered"), joined([fault, verify]) or verify)

    async def _failed(self, place: _AnchorPlace, reason: Message) -> None:
        if place.is_failing:
            return
        place.is_failing = True
        if place.is_configured:
            self.status = AnchorStatus(self.status.altered, reason, self._clock())
        log.error("audit anchor not written", path=str(place.path), why=str(reason))
        await self._record(Message("event_anchor_not_written"), reason)

    async def _record(self, what: Message, message: Message | str = "") -> None:
        with suppress(StoreError):
            await self._events.record(kind="audit", what=what, message=message)


def changed(before: Mapping[str, Head], heads: Mapping[str, Head]) -> dict[str, Head]:
    """The heads that are others than before."""
    known = {(chain, head.id, head.hash) for chain, head in before.items()}
    return {chain: head for chain, head in heads.items() if (chain, head.id, head.hash) not in known}


def _present_anchor(place: _AnchorPlace, ring: KeyRing) -> dict[str, Head]:
    """The heads that a file names last. One in its default place begins again with a new key."""
    if not place.is_configured and is_of_lost_key(place.path, ring):
        put_aside(place.path)
    return newest_anchor(place.path, ring)


def anchor_notice(status: AnchorStatus, formats: Formats, now: UnixTime) -> Message | None:
    """The notice about an anchor that is behind, or a log that was altered. ``now``: Unix time in seconds."""
    if status.altered is not None:
        return Message("audit_altered_after_anchor")
    if status.unwritten is not None:
        since = formats.since(status.since, now)
        return Message.of("audit_anchor_missed", time=since, reason=status.unwritten)
    return None
