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
    post = target.head("POST /login", more="Content-Length: 500\r\n") + b"\r\n"
    write = "POST /api/v1/buses/line/units/1/speed"
    closing = "Connection: close\r\n"
    bearer = f"Authorization: Bearer guess\r\n{closing}"
    return {
        "malformed": (b"\x00\x01\r\n\r\n", b""),
        "malformed head": (target.head("GET /", more="a b\r\n") + b"\r\n", b""),
        "disconnect in a head": (target.head("GET /"), b""),
        "chunk without a size": (
            post.replace(b"Content-Length: 500", b"Transfer-Encoding: chunked") + b"zz\r\n",
            b"",
        ),
        "chunk without a size and a page": (
            target.head("POST /", more="Transfer-Encoding: chunked\r\n") + b"\r\nzz\r\n",
            b"",
        ),
        "referer": (target.head("POST /", more=f"Referer: http://[\r\n{closing}") + b"\r\n", b""),
        "page of htmx": (
            target.head("GET /", more=f"HX-Request: true\r\nHX-Current-URL: http://[\r\n{closing}") + b"\r\n",
            b"",
        ),
        "disconnect in a body": (post + b"x", b""),
        "disconnect in a command": (
            target.head(write, "operator", "Content-Length: 500\r\n") + b"\r\n{",
            b"",
        ),
        "too large": (post.replace(b"500", b"9999999") + b"x" * 1000, b""),
        "host": (b"GET /login HTTP/1.1\r\nHost: [\r\nConnection: close\r\n\r\n", b""),
        "token": (target.head("GET /api/v1/line", more=bearer) + b"\r\n", b""),
        "worker token": (upgrade(target, "/feed", "", HANDSHAKE + bearer), b""),
        "token of a viewer": (upgrade(target, "/feed", "viewer"), b""),
        "handshake without a key": (
            upgrade(target, "/live", "viewer", "Connection: Upgrade\r\nUpgrade: websocket\r\n"),
            b"",
        ),
        "handshake with a broken key": (
            upgrade(target, "/live", "viewer").replace(b"dGhlIHNhbXBsZSBub25jZQ==", b"\xff\xfe"),
            b"",
        ),
    }


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
    with served.api() as client:  # begun after the others
        assert client.get("/line").status_code == 200
    added = lines(served)[before:]
    assert len(added) <= FEW, added[:10]
    assert not [line for line in added if "Traceback" in line]


def test_clients_that_reset_their_connection_make_few_lines(served: Site, target: Target) -> None:
    """Of pipelined requests uvicorn ends the last one alone, and another is under way."""
    requests = (target.head("GET /login") + b"\r\n") * 8
    before = len(lines(served))
    for _ in range(REQUESTS):
        with socket.create_connection((target.host, target.port), timeout=READ_S) as client:
            client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            client.sendall(requests)
            assert client.recv(1)
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
