"""Requests without a person: what they wait for, and what they cost the others."""

from __future__ import annotations

import asyncio

import pytest
from starlette.types import Message, Receive, Scope, Send

from app.core.web.access import Person, Role
from app.core.web.request_rules import MAX_PLAIN_BODY_BYTES
from app.core.web.routes import (
    ANONYMOUS_AT_ONCE,
    AT_ONCE_OF_ADDRESS,
    MAX_WAITING_OF_ADDRESS,
    AnonymousLimiter,
)
from app.people.auth import sign_in as signin
from tests.app.complete_app import House
from tests.for_each import for_each


class Slow:
    """An app that waits, and notes what it was given."""

    def __init__(self) -> None:
        self.gate = asyncio.Event()
        self.bodies: list[bytes] = []

    async def __call__(self, _scope: Scope, receive: Receive, send: Send) -> None:
        message = await receive()
        self.bodies.append(message["body"])
        await self.gate.wait()
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b""})


class Client:
    """One request: the parts of its body come when they are given."""

    def __init__(
        self, address: str = "192.0.2.1", person: Person | None = None, path: str = "/login"
    ) -> None:
        self.scope: Scope = {
            "type": "http",
            "method": "POST",
            "path": path,
            "headers": [],
            "client": (address, 1),
            "caller": person,
        }
        self.messages: asyncio.Queue[Message] = asyncio.Queue()
        self.status: int | None = None

    def part(self, body: bytes, *, more: bool = False) -> None:
        self.messages.put_nowait({"type": "http.request", "body": body, "more_body": more})

    async def send(self, message: Message) -> None:
        if message["type"] == "http.response.start":
            self.status = message["status"]

    def request(self, app: AnonymousLimiter) -> asyncio.Task[None]:
        return asyncio.create_task(app(self.scope, self.messages.get, self.send))


async def settled() -> None:
    for _ in range(20):
        await asyncio.sleep(0)


async def test_nothing_starts_before_the_body_is_complete() -> None:
    slow, client = Slow(), Client()
    task = client.request(AnonymousLimiter(slow))
    client.part(b"name=a", more=True)
    await settled()
    assert slow.bodies == []
    client.part(b"&password=b")
    await settled()
    assert slow.bodies == [b"name=a&password=b"]
    slow.gate.set()
    await task
    assert client.status == 200


async def test_a_client_that_leaves_amid_its_body_takes_no_turn() -> None:
    slow, client = Slow(), Client()
    task = client.request(AnonymousLimiter(slow))
    client.part(b"x", more=True)
    client.messages.put_nowait({"type": "http.disconnect"})
    await task
    assert (slow.bodies, client.status) == ([], None)


async def test_an_address_has_few_at_a_time_and_another_has_its_own() -> None:
    slow = Slow()
    app = AnonymousLimiter(slow)
    clients = [Client() for _ in range(5)] + [Client("192.0.2.2")]
    tasks = [client.request(app) for client in clients]
    for number, client in enumerate(clients):
        client.part(str(number).encode())
    await settled()
    assert slow.bodies == [b"0", b"5"]
    assert (ANONYMOUS_AT_ONCE, AT_ONCE_OF_ADDRESS) == (2, 1)
    slow.gate.set()
    await asyncio.gather(*tasks)
    assert {client.status for client in clients} == {200}


async def test_health_and_people_do_not_wait() -> None:
    slow = Slow()
    app = AnonymousLimiter(slow)
    clients = [
        Client(),
        Client(),
        Client(path="/healthz"),
        Client(person=Person("ann", Role.VIEWER, "session")),
    ]
    tasks = [client.request(app) for client in clients]
    for number, client in enumerate(clients):
        client.part(str(number).encode())
    await settled()
    assert sorted(slow.bodies) == [b"0", b"2", b"3"]
    slow.gate.set()
    await asyncio.gather(*tasks)


async def test_beyond_those_that_wait_an_address_is_refused() -> None:
    slow = Slow()
    app = AnonymousLimiter(slow)
    clients = [Client() for _ in range(AT_ONCE_OF_ADDRESS + MAX_WAITING_OF_ADDRESS + 1)]
    tasks = [client.request(app) for client in clients]
    for client in clients:
        client.part(b"")
    await settled()
    assert [client.status for client in clients if client.status] == [429]
    slow.gate.set()
    await asyncio.gather(*tasks)


async def test_a_body_beyond_any_form_is_refused_while_it_arrives() -> None:
    slow, client = Slow(), Client()
    task = client.request(AnonymousLimiter(slow))
    for _ in range(MAX_PLAIN_BODY_BYTES // 16384 + 1):
        client.part(b"x" * 16384, more=True)
    await task
    assert (slow.bodies, client.status) == ([], 413)


@for_each("form", [{}, {"name": "ann"}, {"password": "a long enough secret"}])
async def test_a_sign_in_without_a_name_or_a_secret_tries_nothing(
    house: House, monkeypatch: pytest.MonkeyPatch, form: dict[str, str]
) -> None:
    tried = list[object]()
    monkeypatch.setattr(signin, "verify_secret", lambda *secret: tried.append(secret))
    response = await house.client().post("/login", data=form)
    assert (response.status_code, tried) == (401, [])
    assert await house.events("login_refused") == []
