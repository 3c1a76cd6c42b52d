"""The lines of a plant over its broker: each server publishes the summary of each of its lines as a retained
document, and a server with ``overview = true`` shows those of all others.

The document is that of ``GET /api/v1/sites?own=true`` for one line, with the address of its page. It is
checked like a peer's report; nothing of it is stored.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from hashlib import blake2b

import msgspec
import structlog

from app.core.server.settings import check_web_url
from app.line.live.fields import Translator
from app.system.mqtt.node import LINES
from app.system.mqtt.session import RETRY_S, BrokerError, connected, identifier_for
from app.system.mqtt.settings import MqttSettings, identifier_of
from app.system.peers.board import AWAY_AFTER_S, LineBoard, Peer
from app.system.peers.client import ReportError, board_json, read_report
from bus.instants import Monotonic, UnixTime
from bus.messages import Message, in_english, number

MAX_LINES = 1000
MAX_BYTES = 64 * 1024
MAX_URL = 300
log = structlog.get_logger()


class _Page(msgspec.Struct):
    """The part of a document that a peer's report does not have."""

    page: str = ""


@dataclass(frozen=True, slots=True)
class LineDocuments:
    """The maker of the documents of this server's lines. ``page``: the address of its pages."""

    board: LineBoard
    english: Translator
    page: str

    def document(self, bus: str, now: UnixTime) -> bytes:
        """Return the document of a line."""
        report = board_json(self.board, self.english, now, own=True)
        report["lines"] = [line for line in report["lines"] if line["bus"] == bus]
        report["instance"] = f"{report['instance']}-{bus}"[:60]
        return msgspec.json.encode({**report, "page": self.page})


@dataclass(eq=False, repr=False)
class BrokerLines:
    """The lines that other servers publish on the broker, shown on a board like those of peers. ``own``: the
    topics of this server's lines; ``fault``: why none are read now."""

    settings: MqttSettings
    board: LineBoard
    own: frozenset[str] = frozenset()
    fault: Message | None = None
    _peers: dict[str, Peer] = field(default_factory=dict)
    _former: dict[str, tuple[str, Monotonic]] = field(default_factory=dict)

    async def follow(self) -> None:
        """Read documents until canceled; after a failure, wait and connect again."""
        failures = 0
        while True:
            try:
                await self._connection()
            except BrokerError as error:
                if error.message != self.fault:
                    log.warning("overview lost", why=in_english(error.message))
                self.fault = error.message
                for peer in self._peers.values():
                    peer.fault = error.message
            await asyncio.sleep(RETRY_S[min(failures, len(RETRY_S) - 1)])
            failures += 1

    def state(self) -> Message:
        """Return a sentence about the other servers' lines that are shown."""
        if self.fault is not None:
            return Message.of("mqtt_overview_lacks", reason=self.fault)
        shown = number(str(len(self._peers)))
        return Message.of("mqtt_overview_has", place=self.settings.place, lines=shown)

    async def _connection(self) -> None:
        identifier = identifier_for("overview", self.board.instance)
        async with connected(self.settings, identifier) as client:
            await client.subscribe(f"{LINES}/+/+", 0)
            self.fault = None
            async for message in client.messages:
                if isinstance(message.payload, bytes):
                    self.take(str(message.topic), message.payload, is_retained=message.retain)

    def take(self, topic: str, payload: bytes, *, is_retained: bool) -> None:
        """Show the line of a received document. An empty document removes the line; one that the broker had
        retained shows it as stale. The broker's rules permit a topic, so the names in a document count only
        as far as they agree with its topic."""
        if topic in self.own:
            return
        if not payload:
            peer = self._peers.pop(topic, None)
            if peer is not None:
                self.board.peers.remove(peer)
            return
        peer = self._peers.get(topic)
        if peer is None and len(self._peers) >= MAX_LINES:
            self.fault = Message.of("mqtt_too_many_lines", n=MAX_LINES)
            return
        try:
            lines, instance, time = read_report(payload[:MAX_BYTES])
            page = _page_in(payload)
        except ReportError:
            log.debug("no document of a line", topic=topic[:200])
            return
        group, bus = topic.split("/")[-2:]
        if lines.keys() != {bus}:
            return
        site = lines[bus].site
        name = site if identifier_of(site) == group else f"{site} ({group})"
        if peer is None:
            peer = self._peers[topic] = Peer(_number(topic), name, page)
            self.board.peers.append(peer)
        peer.name, peer.url = name, page
        if self._is_another(topic, peer, instance):
            peer.fault = Message("mqtt_two_publishers")
            return
        peer.fault = self.board.put(peer, lines, instance, time)
        if is_retained:
            peer.reported_at = Monotonic(float(self.board.clock()) - AWAY_AFTER_S)

    def _is_another(self, topic: str, peer: Peer, instance: str) -> bool:
        """Return whether two servers publish this line: the one that had ended is back."""
        now = self.board.clock()
        former, at = self._former.get(topic, ("", now))
        if peer.instance and instance != peer.instance:
            self._former[topic] = (peer.instance, now)
        return instance == former and now - at < AWAY_AFTER_S


def _number(topic: str) -> int:
    """Return a number for a topic, the same in every copy of this server: pages name tiles by it."""
    return int.from_bytes(blake2b(topic.encode(), digest_size=6).digest(), "big")


def _page_in(payload: bytes) -> str:
    """Return the address of a line's page; empty if a browser may not be led there."""
    try:
        written = msgspec.json.decode(payload[:MAX_BYTES], type=_Page).page
        return check_web_url(written[:MAX_URL]).rstrip("/") if written else ""
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return ""
