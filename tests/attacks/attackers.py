"""Attacks on a server by HTTP or HTTPS, each in a separate process: ``python -m tests.attacks.attackers NAME
URL SECONDS CORE TOKENS`` (CORE: that of the attacker; TOKENS: JSON, by role).
"""

from __future__ import annotations

import asyncio
import json
import os
import ssl
import struct
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import cycle
from urllib.parse import urlsplit

Attack = Callable[["Target"], Awaitable[None]]
HANDSHAKE = (
    "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
)
ERRORS = (OSError, EOFError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError)
CLOSE = "Connection: close\r\n"
GERMAN = f"Accept-Language: de\r\nAccept: text/html\r\n{CLOSE}"
CHUNKED = "Transfer-Encoding: chunked\r\n"


@dataclass
class Target:
    """A server, and what the attacker has stolen. ``end``: on the monotonic clock; ``tls``: of HTTPS."""

    host: str
    port: int
    tokens: dict[str, str]
    end: float
    tls: ssl.SSLContext | None = None

    @property
    def goes_on(self) -> bool:
        return time.monotonic() < self.end

    def head(self, line: str, role: str = "", more: str = "") -> bytes:
        """A request's head without its last empty line."""
        token = f"Authorization: Bearer {self.tokens[role]}\r\n" if role else ""
        return f"{line} HTTP/1.1\r\nHost: {self.host}:{self.port}\r\n{token}{more}".encode()

    async def open(self, begun: bytes = b"") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection(self.host, self.port, ssl=self.tls)
        writer.write(begun)
        return reader, writer

    async def send(self, request: bytes) -> None:
        """Send one request on a new connection and read its response to the end."""
        reader, writer = await self.open(request)
        try:
            await asyncio.wait_for(reader.read(), 30)
        finally:
            writer.close()


async def many(target: Target, count: int, one: Attack) -> None:
    """Run ``count`` at a time, each repeatedly until the end."""

    async def again() -> None:
        while target.goes_on:
            begun = time.monotonic()
            with suppress(*ERRORS):
                await one(target)
            await asyncio.sleep(0.02 if time.monotonic() - begun < 0.02 else 0)

    await asyncio.gather(*(again() for _ in range(count)))


async def _read(reader: asyncio.StreamReader) -> None:
    with suppress(*ERRORS):
        while await reader.read(65536):
            pass


def frame(opcode: int, payload: bytes = b"", size: int | None = None) -> bytes:
    """Return a frame as a client sends it (RFC 6455, 5.2), masked with zeros; ``size``: the length that it
    claims.
    """
    size = len(payload) if size is None else size
    length = bytes([0x80 | size]) if size < 126 else struct.pack("!BQ", 0x80 | 127, size)
    return bytes([opcode]) + length + b"\0\0\0\0" + payload


@dataclass(frozen=True)
class Begun:
    """What a connection begins with: a head and ``body``, ``times`` over.

    ``is_page``: with the origin of the server, as a browser states it. ``end``: of the head; none for a head
    that goes on.
    """

    line: str
    role: str = ""
    more: str = ""
    body: bytes = b""
    times: int = 1
    is_page: bool = False
    end: bytes = b"\r\n"

    def on(self, target: Target) -> bytes:
        """The bytes for this server."""
        scheme = "https" if target.tls else "http"
        origin = f"Origin: {scheme}://{target.host}:{target.port}\r\n" if self.is_page else ""
        return (target.head(self.line, self.role, origin + self.more) + self.end + self.body) * self.times


def post(path: str, body: bytes, kind: str, role: str = "") -> Begun:
    """A request with its body."""
    return Begun(
        f"POST {path}", role, f"Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n{CLOSE}", body
    )


def get(path: str, role: str = "", more: str = CLOSE) -> Begun:
    """A request, after whose response the connection ends."""
    return Begun(f"GET {path}", role, more)


LIVE = Begun("GET /live", "viewer", HANDSHAKE, is_page=True)
FEED = Begun("GET /feed", "worker", HANDSHAKE)


def sent(*begun: Begun) -> Attack:
    """Each in turn on a new connection, whose response is read to its end."""
    turns = cycle(begun)
    return lambda target: target.send(next(turns).on(target))


def held(begun: Begun | None, more: bytes = b"", every_s: float = 1.0) -> Attack:
    """Keep a connection on which nothing is read, with ``more`` now and then."""

    async def hold(target: Target) -> None:
        _, writer = await target.open(begun.on(target) if begun else b"")
        try:
            while target.goes_on and not writer.is_closing():
                await asyncio.sleep(every_s)
                writer.write(more)
        finally:
            writer.transport.abort()

    return hold


def mixed(*attacks: Attack) -> Attack:
    """Each in turn, so that all go on at the same time."""
    turns = cycle(attacks)
    return lambda target: next(turns)(target)


def sipped(*begun: Begun, every_s: float = 0.5) -> Attack:
    """Read the response a few bytes at a time."""
    turns = cycle(begun)

    async def sip(target: Target) -> None:
        reader, writer = await target.open(next(turns).on(target))
        try:
            while target.goes_on:
                await asyncio.wait_for(reader.readexactly(16), 30)
                await asyncio.sleep(every_s)
        finally:
            writer.transport.abort()

    return sip


def flooded(
    begun: Begun, flood: bytes = b"", *, once: bytes = b"", every_s: float = 0.0, reads: bool = True
) -> Attack:
    """Send ``once`` and then ``flood`` as quickly as it is taken, until the server ends the connection; on a
    WebSocket once it is open."""

    async def pour(target: Target) -> None:
        reader, writer = await target.open(begun.on(target))
        reading = None
        try:
            if HANDSHAKE in begun.more:
                await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60)
            reading = asyncio.create_task(_read(reader)) if reads else None
            writer.write(once)
            while target.goes_on and not writer.is_closing() and not reader.at_eof():
                writer.write(flood)
                await asyncio.wait_for(writer.drain(), 10)
                await asyncio.sleep(every_s)
        finally:
            writer.transport.abort()
            if reading is not None:
                reading.cancel()

    return pour


def left(begun: Begun) -> Attack:
    """Leave once the head of the response has come."""

    async def leave(target: Target) -> None:
        reader, writer = await target.open(begun.on(target))
        try:
            await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 30)
        finally:
            writer.transport.abort()

    return leave


HEALTH = get("/healthz", more="")


async def _polls(target: Target) -> None:
    request = HEALTH.on(target)
    reader, writer = await target.open(request * 6)
    try:
        while target.goes_on:
            await asyncio.wait_for(reader.readuntil(b'{"status":"ok"}'), 30)
            writer.write(request)
    finally:
        writer.transport.abort()


async def _one_after_another(target: Target) -> None:
    while target.goes_on:
        await target.send(get("/healthz").on(target))


async def _form_in_two_parts(target: Target) -> None:
    head, body = post("/login", b"name=a", "application/x-www-form-urlencoded").on(target), 6
    reader, writer = await target.open(head[:-body])
    try:
        await asyncio.sleep(0.05)
        writer.write(head[-body:])
        await asyncio.wait_for(reader.read(), 30)
    finally:
        writer.close()


SPEED = "/api/v1/buses/line/units/1/speed"
RESTORES = "/api/v1/buses/line/units/1/restores"
JSON = "application/json"
KEYS = ("{" + ",".join(f'"{n}":0' for n in range(24_000)) + ',"0":0}').encode()
SETPOINT = b'{"raw":100}'
MEGABYTE = json.dumps({"document": "".join(f"k{n} = 1\n" for n in range(110_000))}).encode()
DOTS = json.dumps({"document": "a." * 500_000 + "a = 1"}).encode()
PUNYCODE = b'--b\r\nContent-Disposition: form-data; name="name"\r\n\r\n' + b"9" * 60_000 + b"\r\n--b--\r\n"
QUOTED = 'Cookie: lineside_session="' + "\\\\" * 14_000 + f'"\r\n{CLOSE}'
HEAD = Begun("GET /login", end=b"")
FORM = Begun("POST /login", more="Content-Length: 50000\r\n")
CHUNKS = Begun("POST /login", more=CHUNKED)
STREAMS = tuple(get("/api/v1/stream", role, "") for role in ("viewer", "operator", "admin"))
SNAPSHOT = frame(0x81, b'{"want":"snapshot"}')
EVERYTHING = frame(0x81, json.dumps({"units": [f"line/{n}" for n in range(1, 256)]}).encode())
EVERY_LINE = frame(0x81, b'{"lines":true,"want":"snapshot"}')
TOO_LARGE = frame(0x81, b"x" * 60_000, size=100_000_000)
GZIP = f"Accept-Encoding: gzip\r\n{CLOSE}"
EVENTS = "/api/v1/events?limit=1000"

ATTACKS: dict[str, tuple[int, Attack]] = {
    "nothing": (0, held(None)),
    "connections without a request": (600, held(None)),
    "heads without an end": (600, held(HEAD, b"X-A: b\r\n")),
    "bodies without an end": (600, held(FORM, b"x")),
    "heads and bodies without an end": (600, mixed(held(HEAD, b"X-A: b\r\n"), held(FORM, b"x"))),
    "chunks without an end": (200, held(CHUNKS, b"1\r\nx\r\n", 0.05)),
    "unread responses": (200, held(get("/api/v1/events.csv", "viewer", ""))),
    "requests by the thousand at once": (8, sent(Begun("GET /login", times=3000))),
    "addresses with patterns": (12, sent(get("/static/x/" + "%3A%20" * 150, more=GERMAN))),
    "queries with patterns": (12, sent(get("/login?next=/&" + "%3B%20a%3A%20=" * 1200, more=GERMAN))),
    "cookies to unquote": (12, sent(get("/login", more=QUOTED))),
    "forms in punycode": (
        12,
        sent(post("/login", PUNYCODE, "multipart/form-data; charset=punycode; boundary=b")),
    ),
    "keys by the thousand": (12, sent(*(post(SPEED, KEYS, JSON, role) for role in ("viewer", "engineer")))),
    "setpoints without end": (30, sent(post("/api/v1/buses/line/units/2/speed", SETPOINT, JSON, "engineer"))),
    "documents of a megabyte": (6, sent(post(RESTORES, MEGABYTE, JSON, "engineer"))),
    "keys with dots": (6, sent(post(RESTORES, DOTS, JSON, "engineer"))),
    "searches": (12, sent(get(f"{EVENTS}&search=no-such-word", "viewer"))),
    "pages of a thousand events": (12, sent(get(EVENTS, "viewer"))),
    "downloads of events": (12, sent(get("/api/v1/events.csv", "viewer"))),
    "traces of two thousand frames": (12, sent(get("/api/v1/buses/line/trace?limit=2000", "engineer"))),
    "tokens to guess": (12, sent(get("/api/v1/line", more=f"Authorization: Bearer guess\r\n{CLOSE}"))),
    "pages without a sign in": (12, sent(get("/login", more=GERMAN))),
    "snapshots without end": (20, flooded(LIVE, SNAPSHOT * 2000, every_s=1.0, reads=False)),
    "snapshots at the limit": (50, flooded(LIVE, SNAPSHOT, every_s=0.2)),
    "pages by the hundred": (400, flooded(LIVE, EVERYTHING, every_s=2.0)),
    "pages that turn": (50, flooded(LIVE, EVERYTHING + frame(0x81, b"{}"), every_s=0.25)),
    "pages that open and close": (12, left(LIVE)),
    "pages by the hundred that open and close": (200, left(LIVE)),
    "forms in two parts": (300, _form_in_two_parts),
    "streams that no one reads": (100, held(STREAMS[0])),
    "streams read slowly": (60, sipped(*STREAMS)),
    "streams without a sign in": (200, held(get("/api/v1/stream", more=""))),
    "first pages of a viewer": (32, sent(get("/", "viewer"))),
    "wallboards without end": (12, sent(get("/wallboard", "viewer"))),
    "wallboards without a sign in": (60, sent(get("/wallboard", more=f"Accept: text/html\r\n{CLOSE}"))),
    "wallboards read slowly": (200, sipped(get("/wallboard", "viewer", ""))),
    "wallboards by the hundred that no one reads": (
        200,
        flooded(LIVE, EVERY_LINE, every_s=0.5, reads=False),
    ),
    "streams that open and close": (40, left(STREAMS[0])),
    "pings without end": (20, flooded(LIVE, frame(0x89, b"x" * 100) * 2000, every_s=0.05, reads=False)),
    "frames of a hundred megabytes": (20, flooded(LIVE, TOO_LARGE, every_s=0.05)),
    "fragments without end": (20, flooded(LIVE, frame(0x01) + frame(0x00) * 5000, every_s=0.05)),
    "frames before the response": (20, sent(replace(LIVE, body=TOO_LARGE))),
    "chunks of a byte": (1, flooded(CHUNKS, b"1\r\na\r\n" * 20_000)),
    "chunks of a byte four times": (4, flooded(CHUNKS, b"1\r\na\r\n" * 20_000)),
    "chunk extensions without end": (4, flooded(CHUNKS, b"1;" + b"x" * 120_000 + b"\r\na\r\n")),
    "one chunk extension without end": (4, flooded(replace(CHUNKS, body=b"1;"), b"x" * 120_000)),
    "blank lines without end": (4, flooded(HEALTH, b"\r\n" * 60_000)),
    "health by 64 connections": (64, _polls),
    "a connection for each request": (32, _one_after_another),
    "descriptions of every call": (16, sent(get("/api/v1/openapi.json", "viewer"))),
    "descriptions compressed": (16, sent(get("/api/v1/openapi.json", "viewer", GZIP))),
    "empty messages before hello": (8, flooded(FEED, frame(0x82) * 20_000)),
    "pings before hello": (8, flooded(FEED, frame(0x89) * 20_000)),
    "empty fragments before hello": (8, flooded(FEED, frame(0x00) * 20_000, once=frame(0x02))),
    "unfinished messages before hello": (
        20,
        flooded(FEED, once=frame(0x82, b"x" * 3_000_000, size=4_000_000), every_s=0.2),
    ),
}
"""By name: on how many connections at a time, and what is done on each, again and again."""
EACH, FEW = "each", 2


async def main(name: str, url: str, seconds: float, core: int, tokens: dict[str, str]) -> None:
    """Attack for so long, on one core; `EACH`: with one attack after the other, on few connections."""
    os.sched_setaffinity(0, {core})
    parts = urlsplit(url)
    tls = ssl._create_unverified_context() if parts.scheme == "https" else None
    for each in ATTACKS if name == EACH else (name,):
        target = Target(parts.hostname or "", parts.port or 80, tokens, time.monotonic() + seconds, tls)
        count, one = ATTACKS[each]
        try:
            await asyncio.wait_for(many(target, min(count, FEW) if name == EACH else count, one), seconds + 1)
        except TimeoutError:
            continue
        except Exception as error:
            error.add_note(f"in the attack {each}")
            raise
        await asyncio.sleep(target.end - time.monotonic())


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4]), json.loads(sys.argv[5])))
