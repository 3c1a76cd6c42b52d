"""Searches and downloads of one account, and what is left for the others."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from math import inf
from pathlib import Path
from typing import Any

import pytest
from fastapi import APIRouter, Depends, FastAPI
from starlette.responses import StreamingResponse
from starlette.types import Message

from app.core.server.turns import FairQueue
from app.core.web.access import Person, Role, public
from app.core.web.routes import (
    MAX_AT_ONCE,
    MAX_READS,
    GuardedRoute,
    Turns,
)
from app.core.web.services import Registry
from app.line.history.service import History
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from tests.app.complete_app import House, complete_app
from tests.app.gated import until
from tests.sizes import sizes

SEARCHES = (
    "/api/v1/events?search=nothing-like-it",
    "/events?search=nothing-like-it",
    "/api/v1/events.csv?search=nothing-like-it",
    "/api/v1/history?bus=dry-end&unit=1&value=actual",
    "/api/v1/history/series?series=dry-end/1/actual",
    "/api/v1/history/sparks?series=dry-end/1/actual",
    "/api/v1/history/marks",
    "/api/v1/history/export?series=dry-end/1/actual",
)


@pytest.fixture
async def house(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[House]:
    # The server's own queries would be counted as those of an account.
    monkeypatch.setattr("app.line.live.change_recorder.LOOK_EVERY_S", inf)
    monkeypatch.setattr("app.system.peers.summary.READ", ())
    async with complete_app(tmp_path) as house:
        yield house


@pytest.mark.parametrize("path", [*sizes(SEARCHES[0], *SEARCHES[1:-1]), SEARCHES[-1]])
async def test_an_account_has_few_at_a_time_and_others_do_not_wait(
    house: House, monkeypatch: pytest.MonkeyPatch, path: str
) -> None:
    running, gate, most = 0, asyncio.Event(), 0

    def slow(original: Callable[..., Any]) -> Callable[..., Any]:
        async def held(*args: Any, **how: Any) -> Any:
            nonlocal running, most
            running += 1
            most = max(most, running)
            await gate.wait()
            running -= 1
            return await original(*args, **how)

        return held

    monkeypatch.setattr(house.services[EventLog], "page", slow(house.services[EventLog].page))
    monkeypatch.setattr(house.services[History], "read", slow(house.services[History].read))
    one, other = await house.signed_in(Role.VIEWER, "ann"), await house.signed_in(Role.OPERATOR, "ben")
    pending = [asyncio.create_task(one.get(path)) for _ in range(12)]
    await until(lambda: running == MAX_AT_ONCE)
    assert (await one.get("/healthz")).status_code == 200
    assert (await other.get("/api/v1/line")).status_code == 200
    theirs = asyncio.create_task(other.get(path))
    await until(lambda: running == MAX_AT_ONCE + 1)
    gate.set()
    assert {response.status_code for response in await asyncio.gather(*pending, theirs)} == {200}
    assert most == MAX_AT_ONCE + 1


async def test_a_download_keeps_its_turn_until_it_is_read(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, begun = asyncio.Event(), 0

    async def every(*_: Any) -> AsyncIterator[list[Any]]:
        nonlocal begun
        begun += 1
        yield []
        await gate.wait()

    monkeypatch.setattr(house.services[EventLog], "every", every)
    client = await house.program(Role.VIEWER)
    pending = [asyncio.create_task(client.get("/api/v1/events.csv")) for _ in range(MAX_AT_ONCE + 2)]
    await until(lambda: house.services[Turns].downloads.count_of("key-viewer (token)") == MAX_AT_ONCE + 2)
    await until(lambda: begun >= MAX_AT_ONCE)
    assert begun == MAX_AT_ONCE
    gate.set()
    assert [response.status_code for response in await asyncio.gather(*pending)] == [200] * len(pending)
    assert begun == MAX_AT_ONCE + 2
    assert not house.services[Turns].downloads.count_of("key-viewer (token)")


async def test_what_an_account_reads_comes_in_turns_and_others_do_not_wait(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, running = asyncio.Event(), 0

    async def slow(*_: Any) -> list[Any]:
        nonlocal running
        running += 1
        await gate.wait()
        return []

    monkeypatch.setattr(house.services[Accounts], "users", slow)
    ann, ben = await house.signed_in(Role.ADMIN, "ann"), await house.signed_in(Role.ADMIN, "ben")
    pending = [asyncio.create_task(ann.get("/users")) for _ in range(MAX_READS + 5)]
    await until(lambda: running == MAX_READS)
    pending.append(asyncio.create_task(ben.get("/users")))
    await until(lambda: running == MAX_READS + 1)
    assert (await ann.post("/logout")).status_code == 303
    gate.set()
    assert {response.status_code for response in await asyncio.gather(*pending)} == {200}


async def test_a_response_that_is_being_sent_has_no_turn_any_more() -> None:
    app, router = FastAPI(), APIRouter(route_class=GuardedRoute)
    turns = Turns(reads=FairQueue(inf, 1, 0))
    app.state.services = Registry((turns,))
    gate, begun = asyncio.Event(), 0

    @router.get("/stream", dependencies=[Depends(public)])
    async def stream() -> StreamingResponse:
        async def pieces() -> AsyncIterator[bytes]:
            nonlocal begun
            begun += 1
            yield b"piece"
            await gate.wait()

        return StreamingResponse(pieces())

    async def ignore(_: Message) -> None:
        return None

    async def receive() -> Message:
        await gate.wait()
        return {"type": "http.disconnect"}

    app.router.routes.extend(router.routes)
    scope = {"type": "http", "method": "GET", "path": "/stream", "query_string": b"", "headers": []}
    scope["caller"] = Person("ann", Role.VIEWER, "session")
    sent = [asyncio.create_task(app({**scope}, receive, ignore))]
    await until(lambda: begun == 1)
    sent.append(asyncio.create_task(app({**scope}, receive, ignore)))
    await until(lambda: begun == 2)
    assert not turns.reads.count_of("ann")
    gate.set()
    await asyncio.gather(*sent)
