"""What an account may do now: from memory, at most a second old, and never trusted when it denies."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.web.access import Person, Role
from app.errors import Problem, StoreError
from app.people.auth import store
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

ANN = Person("ann", Role.ENGINEER, "session", credential="a")
PROGRAM = Person("ann", Role.ENGINEER, "token", credential="a")


@pytest.mark.parametrize(
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
    scene.now += 0.001
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
