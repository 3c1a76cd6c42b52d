"""Hostile requests by the hundred make a few lines of the log, whatever they are."""

from __future__ import annotations

import json
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from urllib.parse import urlsplit

import pytest

from tests.attacks.attackers import HANDSHAKE, Target, frame
from tests.attacks.measure import add_worker_token
from tests.e2e.site import Site, eventually, site
from tests.sizes import sizes

REQUESTS = 20
FEW = 3
READ_S = 10.0


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    with site(tmp_path_factory.mktemp("logged"), 1) as served:
        add_worker_token(served)
        yield served


@pytest.fixture
def target(served: Site) -> Target:
    parts = urlsplit(served.url)
    return Target(parts.hostname or "", parts.port or 0, served.tokens, 0.0)


def upgrade(target: Target, path: str, role: str, more: str = HANDSHAKE) -> bytes:
    origin = f"Origin: http://{target.host}:{target.port}\r\n"
    return target.head(f"GET {path}", role, origin + more) + b"\r\n"


def bodies(target: Target) -> dict[str, tuple[bytes, bytes]]:
    """Requests that are refused by their first bytes, and nothing after them."""

    def head(line: str, more: str = "", role: str = "") -> bytes:
        return target.head(line, role, more) + b"\r\n"

    closing = "Connection: close\r\n"
    bearer, chunked = f"Authorization: Bearer guess\r\n{closing}", "Transfer-Encoding: chunked\r\n"
    post, large = head("POST /login", "Content-Length: 500\r\n"), "Content-Length: 9999999\r\n"
    page = f"HX-Request: true\r\nHX-Current-URL: http://[\r\n{closing}"
    live = upgrade(target, "/live", "viewer")
    without_key = "Connection: Upgrade\r\nUpgrade: websocket\r\n"
    write = head("POST /api/v1/buses/line/units/1/speed", "Content-Length: 500\r\n", "operator")
    sent = {
        "malformed": b"\x00\x01\r\n\r\n",
        "malformed head": head("GET /", "a b\r\n"),
        "disconnect in a head": target.head("GET /"),
        "chunk without a size": head("POST /login", chunked) + b"zz\r\n",
        "chunk without a size and a page": head("POST /", chunked) + b"zz\r\n",
        "referer": head("POST /", f"Referer: http://[\r\n{closing}"),
        "page of htmx": head("GET /", page),
        "disconnect in a body": post + b"x",
        "disconnect in a command": write + b"{",
        "too large": head("POST /login", large) + b"x" * 1000,
        "host": b"GET /login HTTP/1.1\r\nHost: [\r\nConnection: close\r\n\r\n",
        "token": head("GET /api/v1/line", bearer),
        "worker token": upgrade(target, "/feed", "", HANDSHAKE + bearer),
        "token of a viewer": upgrade(target, "/feed", "viewer"),
        "handshake without a key": upgrade(target, "/live", "viewer", without_key),
        "handshake with a broken key": live.replace(b"dGhlIHNhbXBsZSBub25jZQ==", b"\xff\xfe"),
    }
    return {kind: (begun, b"") for kind, begun in sent.items()}


def frames(target: Target) -> dict[str, tuple[bytes, bytes]]:
    """Handshakes, and what is sent once they have their response."""
    live, feed = upgrade(target, "/live", "viewer"), upgrade(target, "/feed", "worker")
    return {
        "text that is none": (live, frame(0x81, b"\xff\xfe")),
        "an unknown frame": (live, frame(0x83, b"x")),
        "a frame without a mask": (live, b"\x81\x01a"),
        "a frame too large": (live, frame(0x81, b"x", size=100_000_000)),
        "a close of one byte": (live, frame(0x88, b"x")),
        "a close in broken text": (live, frame(0x88, b"\x03\xe8\xff\xfe")),
        "a continuation of nothing": (live, frame(0x80, b"x")),
        "no message": (live, frame(0x81, b"{{{")),
        "bytes": (live, frame(0x82, b"{}")),
        "no Hello": (feed, frame(0x82, b"x")),
        "text to the feed": (feed, frame(0x81, b"\xff")),
    }


KINDS = (*bodies(Target("", 0, dict.fromkeys(("viewer", "worker", "operator"), ""), 0.0)),)
FRAMES = (*frames(Target("", 0, dict.fromkeys(("viewer", "worker", "operator"), ""), 0.0)),)


@pytest.mark.parametrize("kind", [*KINDS, *sizes(*FRAMES)])
def test_refused_requests_make_few_lines(served: Site, target: Target, kind: str) -> None:
    begun, then = (bodies(target) | frames(target))[kind]
    before = len(lines(served))
    for _ in range(REQUESTS):
        exchange(target, begun, then)
    few_lines_since(served, before)


def test_clients_that_reset_their_connection_make_few_lines(served: Site, target: Target) -> None:
    """Of pipelined requests uvicorn ends the last one alone, and another is under way."""
    requests = (target.head("GET /login") + b"\r\n") * 8
    before = len(lines(served))
    for _ in range(REQUESTS):
        with socket.create_connection((target.host, target.port), timeout=READ_S) as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.sendall(requests)
            assert client.recv(1)
    few_lines_since(served, before)


def few_lines_since(served: Site, before: int) -> None:
    """Check the log once a request that was begun after the others has its response."""
    with served.api() as client:
        assert client.get("/line").status_code == 200
    added = lines(served)[before:]
    assert len(added) <= FEW, added[:10]
    assert not [line for line in added if "Traceback" in line]


def exchange(target: Target, begun: bytes, then: bytes) -> None:
    """Send a request; where ``then`` follows its response, read to the end of the connection."""
    with socket.create_connection((target.host, target.port), timeout=READ_S) as client, suppress(OSError):
        client.sendall(begun)
        if then:
            client.recv(4096)
            client.sendall(then)
        client.shutdown(socket.SHUT_WR)
        while client.recv(65536):
            pass


def lines(served: Site) -> list[str]:
    """What the server has logged of its clients: the worker's process logs into the same file."""
    logged = (served.folder / "serve.log").read_text().splitlines()
    return [line for line in logged if '"bus": "line"' not in line or '"level": "info"' not in line]


def test_a_refused_worker_is_one_line_with_its_address(served: Site, target: Target) -> None:
    exchange(target, *bodies(target)["worker token"])
    shown = eventually(lambda: [line for line in lines(served) if "request refused" in line], "a line")
    assert {json.loads(line)["address"] for line in shown} == {"127.0.0.1"}
