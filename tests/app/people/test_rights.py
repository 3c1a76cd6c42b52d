"""Rights as they are now: ended here, in another process or by themselves, and what ends with them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, MutableMapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from starlette.types import Send

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import Problem, StoreError
from app.people.audit.log import EventLog
from app.people.auth import rules, store
from app.people.auth.accounts import Accounts
from app.people.auth.identify import NO_LONGER_SIGNED_IN, run_while_allowed
from app.people.auth.rights import (
    FRESH_S,
    PASSWORD_CHANGED,
    ROLE_LOWERED,
    TOKEN_ENDED,
    USER_ENDED,
    Rights,
    Standing,
    why_withdrawn,
)
from app.people.auth.store import Token, User
from bus.messages import Message
from tests.administrator import BY
from tests.for_each import for_each

ANN = Person("ann", Role.ENGINEER, "session", credential="a")


PROGRAM = Person("ann", Role.ENGINEER, "token", credential="a")


@for_each(
    ("person", "standing", "reason"),
    [
        (ANN, Standing(Role.ENGINEER, "a"), None),
        (ANN, Standing(Role.ADMIN, "a"), None),
        (ANN, Standing(Role.OPERATOR, "a"), ROLE_LOWERED),
        (ANN, Standing(Role.ENGINEER, "b"), PASSWORD_CHANGED),
        (ANN, None, USER_ENDED),
        (PROGRAM, Standing(Role.ENGINEER, "a"), None),
        (PROGRAM, Standing(Role.VIEWER, "a"), ROLE_LOWERED),
        (PROGRAM, Standing(Role.ENGINEER, "b"), TOKEN_ENDED),
        (PROGRAM, None, TOKEN_ENDED),
        (Person("ann", Role.ENGINEER, "session"), Standing(Role.ENGINEER, "a"), PASSWORD_CHANGED),
    ],
)
def test_why_what_a_person_began_must_stop(
    person: Person, standing: Standing | None, reason: Message | None
) -> None:
    assert why_withdrawn(person, standing) == reason


@dataclass
class Scene:
    """Rights over a store, on a clock that stands still until it is moved."""

    database: Database
    now: float = 100.0
    withdrawn: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rights = Rights(self.database, clock=lambda: self.now, monotonic=lambda: self.now)
        self.rights.on_withdrawn(self._note)

    async def _note(self, account: str) -> None:
        self.withdrawn.append(account)

    async def token(self, name: str, role: Role = Role.ENGINEER, expires_at: float | None = None) -> Person:
        """A token made by another process, and the person that it stands for."""
        token = Token(0, name, role, "test", self.now, None, None, expires_at)
        await self.database.write(lambda connection: store.add_token(connection, name.encode(), token))
        stored = await self.database.read(lambda connection: store.token(connection, name.encode()))
        assert stored is not None
        return Person(name, role, "token", credential=f"{stored.id} {stored.created_at}")

    async def revoke(self, name: str) -> None:
        await self.database.write(lambda connection: store.revoke_token(connection, name))

    async def is_allowed(self, person: Person) -> bool:
        try:
            await self.rights.check(person)
        except Problem as problem:
            return (problem.status, problem.code) != (403, "rights_withdrawn")
        return True


@pytest.fixture
async def scene(tmp_path: Path) -> AsyncIterator[Scene]:
    database = Database(tmp_path / "lineside.db")
    yield Scene(database)
    database.close()


async def test_a_token_just_made_by_another_process_is_good_at_once(scene: Scene) -> None:
    await scene.rights.refresh()
    assert await scene.is_allowed(await scene.token("new"))


async def test_what_was_read_longer_ago_than_a_second_permits_nothing(scene: Scene) -> None:
    program = await scene.token("program")
    assert await scene.is_allowed(program)
    await scene.revoke("program")
    scene.now += FRESH_S
    assert await scene.is_allowed(program), "it is looked up in memory"
    assert scene.rights.token(b"program") is not None
    scene.now += 0.001
    assert scene.rights.token(b"program") is None
    assert not await scene.is_allowed(program)
    assert scene.withdrawn == ["program (token)"]


async def test_a_token_expires_without_a_change_of_the_store(scene: Scene) -> None:
    program = await scene.token("program", expires_at=110.0)
    assert await scene.is_allowed(program)
    scene.now = 110.0
    assert not await scene.is_allowed(program)
    assert scene.withdrawn == ["program (token)"]


async def test_who_may_do_more_than_before_loses_nothing(scene: Scene) -> None:
    ann = User("ann", Role.OPERATOR, False, "/", "", False, 1.0, None)
    await scene.database.write(lambda connection: store.add_user(connection, ann, "hash"))
    await scene.rights.refresh()
    await scene.database.write(lambda connection: store.set_role(connection, "ann", Role.ENGINEER))
    await scene.rights.refresh()
    assert scene.withdrawn == []
    for role in (Role.OPERATOR, Role.ADMIN):
        await scene.database.write(lambda connection, role=role: store.set_role(connection, "ann", role))
        await scene.rights.refresh()
    assert scene.withdrawn == ["ann"]


async def test_who_has_no_account_has_none_withdrawn(scene: Scene) -> None:
    for via in ("demo", "worker"):
        assert await scene.is_allowed(Person("server", Role.ENGINEER, via))  # type: ignore[arg-type]


async def test_a_store_that_cannot_be_read_permits_nothing_for_long(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = await scene.token("program")
    assert await scene.is_allowed(program)

    async def broken(_: object) -> None:
        raise StoreError(Message.of("system_error", error="the disk is gone"))

    monkeypatch.setattr(scene.database, "read", broken)
    scene.now += FRESH_S + 0.001
    with pytest.raises(StoreError):
        await scene.rights.check(program)


async def test_a_slow_read_does_not_undo_a_later_one(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    program = await scene.token("program")
    read, slow = scene.database.read, asyncio.Event()

    async def reads_and_dawdles(work: object) -> object:
        found = await read(work)  # type: ignore[arg-type]
        await slow.wait()
        return found

    with monkeypatch.context() as patched:
        patched.setattr(scene.database, "read", reads_and_dawdles)
        older = asyncio.create_task(scene.rights.refresh())
        await asyncio.sleep(0)
    await scene.revoke("program")
    scene.now += 0.1
    await scene.rights.refresh()
    slow.set()
    await older
    assert not await scene.is_allowed(program)


PASSWORD = "correct horse"


class House:
    """A server with its watch, and the command line beside it over the same store."""

    def __init__(self, path: Path) -> None:
        self.now = 1_000_000.0
        self.stores = [Database(path), Database(path, checkpoints=False)]
        self.here, self.elsewhere = (
            Accounts(each, EventLog(each), lambda: self.now, buses=("dry-end",)) for each in self.stores
        )
        self.rights = Rights(self.stores[0], clock=lambda: self.now)
        self.here.on_changed(self.rights.apply)
        self.notified: list[str] = []

        async def receive(account: str) -> None:
            self.notified.append(account)

        self.rights.on_withdrawn(receive)

    def close(self) -> None:
        for each in self.stores:
            each.close()


@pytest.fixture
async def house(tmp_path: Path) -> AsyncIterator[House]:
    house = House(tmp_path / "lineside.db")
    await house.here.add_user("root", Role.ADMIN, PASSWORD, **BY)
    await house.here.add_user("ann", Role.ENGINEER, PASSWORD, **BY)
    await house.here.create_token("plc", Role.OPERATOR, **BY)
    await house.rights.refresh()
    assert house.notified == []
    await house.rights.refresh()
    yield house
    house.close()


@pytest.mark.parametrize(
    ("change", "account"),
    [
        ("revoke", "plc (token)"),
        ("role", "ann"),
        ("disable", "ann"),
        ("remove", "ann"),
        ("password", "ann"),
        ("replace", "plc (token)"),
    ],
)
async def test_a_change_by_another_process_is_reported(house: House, change: str, account: str) -> None:
    there, looked = house.elsewhere, house.rights.changes
    match change:
        case "revoke":
            await there.revoke_token("plc", **BY)
        case "role":
            await there.set_role("ann", Role.VIEWER, **BY)
        case "disable":
            await there.set_disabled("ann", True, **BY)
        case "remove":
            await there.remove_user("ann", **BY)
        case "password":
            await there.set_password("ann", "another good one", **BY)
        case "replace":
            await there.revoke_token("plc", **BY)
            house.now += 0.001
            await there.create_token("plc", Role.OPERATOR, **BY)
    assert house.notified == []
    await house.rights.refresh()
    assert house.notified == [account]
    assert house.rights.changes > looked, "open connections look again"
    await house.rights.refresh()
    assert house.notified == [account]


async def test_a_change_that_ends_no_rights_is_not_reported(house: House) -> None:
    await house.elsewhere.add_user("bob", Role.VIEWER, PASSWORD, **BY)
    await house.elsewhere.create_token("hmi", Role.VIEWER, **BY)
    await house.rights.refresh()
    await house.stores[0].write(lambda c: c.execute("UPDATE users SET seen_at = 5"))
    await house.rights.refresh()
    assert house.notified == []


async def test_a_token_that_expires_is_reported_once(house: House) -> None:
    await house.here.create_token("short", Role.OPERATOR, expires_days=1, **BY)
    await house.rights.refresh()
    house.now += rules.DAY - 1
    await house.rights.refresh()
    assert house.notified == []
    house.now += 1
    await house.rights.refresh()
    await house.rights.refresh()
    assert house.notified == ["short (token)"]


NEVER_S = 1e6


class Socket:
    """Notes what is sent."""

    def __init__(self) -> None:
        self.sent: list[MutableMapping[str, Any]] = []
        self.ended = False

    async def send(self, message: MutableMapping[str, Any]) -> None:
        self.sent.append(message)

    async def work(self, _send: Send) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            self.ended = True


@dataclass
class Right:
    """Of one connection; a test takes it away. ``looks``: how often it was looked up."""

    rights: Rights = field(default_factory=lambda: Rights(None))  # type: ignore[arg-type]
    is_good: bool = True
    looks: int = 0
    on_look: Callable[[], None] = lambda: None

    async def is_allowed(self) -> bool:
        self.looks += 1
        found = self.is_good
        self.on_look()
        return found

    async def withdrawn(self, every_s: float = NEVER_S) -> None:
        await self.rights.until_withdrawn(self.is_allowed, 0, every_s)

    def withdraw(self) -> None:
        self.is_good = False
        self.rights.announce()


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


async def ended(task: asyncio.Future[None]) -> None:
    async with asyncio.timeout(60):
        await task


async def test_it_ends_with_its_right() -> None:
    socket, right = Socket(), Right()
    task = asyncio.ensure_future(run_while_allowed(socket.work, right.withdrawn, socket.send, is_socket=True))
    await settled()
    right.withdraw()
    await ended(task)
    assert socket.ended
    assert socket.sent == [{"type": "websocket.close", "code": NO_LONGER_SIGNED_IN}]


async def test_what_ends_without_a_change_is_noticed_in_time() -> None:
    right = Right(is_good=False)
    await ended(asyncio.ensure_future(right.withdrawn(every_s=0.001)))
    assert right.looks == 1


async def test_a_socket_that_ended_is_not_closed_again() -> None:
    socket = Socket()

    async def short(_: Send) -> None:
        return None

    await run_while_allowed(short, Right().withdrawn, socket.send, is_socket=True)
    assert socket.sent == []


async def test_a_failure_comes_through() -> None:
    async def fail(_: Send) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        await run_while_allowed(fail, Right().withdrawn, Socket().send, is_socket=True)


async def test_a_right_that_cannot_be_looked_up_ends_it_with_the_failure() -> None:
    socket, right = Socket(), Right()

    def fail() -> None:
        raise ZeroDivisionError

    right.on_look = fail
    task = asyncio.ensure_future(run_while_allowed(socket.work, right.withdrawn, socket.send, is_socket=True))
    await settled()
    right.rights.announce()
    with pytest.raises(ZeroDivisionError):
        await ended(task)
    assert socket.ended


async def test_a_server_that_ends_takes_it_along() -> None:
    socket = Socket()
    task = asyncio.ensure_future(
        run_while_allowed(socket.work, Right().withdrawn, socket.send, is_socket=True)
    )
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert socket.ended


async def test_it_is_looked_at_when_rights_change() -> None:
    right = Right()
    task = asyncio.ensure_future(right.withdrawn())
    await settled()
    assert right.looks == 0
    for number in (1, 2):
        right.rights.announce()
        await settled()
        assert right.looks == number
    assert not task.done()
    right.withdraw()
    await ended(task)
    right.rights.announce()


async def test_a_change_before_it_was_followed_or_during_a_look_is_looked_at_too() -> None:
    """Also where the right was taken away before the connection was opened."""
    right = Right()
    right.withdraw()
    await ended(asyncio.ensure_future(right.withdrawn()))
    right = Right()
    task = asyncio.ensure_future(right.withdrawn())
    await settled()
    right.on_look = right.withdraw
    right.rights.announce()
    await ended(task)
    assert right.looks == 2


PIECE = {"type": "http.response.body", "body": b"x", "more_body": True}


@for_each("waits_in", ["the next piece", "a slow reader"])
async def test_a_response_in_pieces_ends_with_its_right(waits_in: str) -> None:
    """It was looked at with the next piece, which a line at rest sends every five seconds."""
    socket, right, waiting, left = Socket(), Right(), asyncio.Event(), False

    async def respond(send: Send) -> None:
        nonlocal left
        try:
            await send(PIECE)
            await send(PIECE)
            waiting.set()
            await asyncio.Event().wait()
        finally:
            left = True

    async def slow(message: MutableMapping[str, Any]) -> None:
        await socket.send(message)
        if waits_in == "a slow reader" and len(socket.sent) == 2:
            waiting.set()
            await asyncio.Event().wait()

    task = asyncio.ensure_future(run_while_allowed(respond, right.withdrawn, slow))
    await waiting.wait()
    right.rights.announce()
    await settled()
    assert not task.done(), "its right is good"
    right.withdraw()
    await ended(task)
    assert (left, len(socket.sent)) == (True, 2)


async def test_a_response_that_a_server_cuts_off_is_canceled() -> None:
    async def respond(send: Send) -> None:
        await send(PIECE)
        await asyncio.Event().wait()

    task = asyncio.ensure_future(run_while_allowed(respond, Right().withdrawn, Socket().send))
    await settled()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await ended(task)


async def test_a_response_at_once_is_not_followed() -> None:
    right = Right()
    right.withdraw()

    async def respond(send: Send) -> None:
        await send({"type": "http.response.body", "body": b"x"})
        await settled()

    await run_while_allowed(respond, right.withdrawn, Socket().send)
    assert right.looks == 0
