"""What one server withdraws ends at the others by a notice, and not only once they look again."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from app.audit.log import EventLog
from app.auth import rules, store
from app.auth.accounts import Accounts
from app.auth.rights import notices, rights
from app.auth.rights.notices import RightsNotice
from app.auth.rights.rights import Rights
from app.auth.settings import Sessions
from app.auth.sign_in.signin import SignIn
from app.database import Database
from app.web.admission.access import Person, Role
from tests.administrator import BY
from tests.app.stage import until

PASSWORD = "correct horse"
Change = Callable[["Elsewhere"], Coroutine[Any, Any, object]]


class Elsewhere:
    """A server, and another over the same store that gets its notices, but never looks without one."""

    def __init__(self, database: Database) -> None:
        self.database, events = database, EventLog(database)
        self.accounts = Accounts(database, events, buses=("dry-end",))
        self.sign_in = SignIn(database, events, Sessions())
        self.rights = Rights(database, lambda _: None)
        self.own_sign_in = SignIn(database, events, Sessions(), rechecks=self.rights.rechecks)
        self.withdrawn: list[str] = []
        self.signed_out: list[str] = []

        async def withdraw(account: str) -> None:
            self.withdrawn.append(account)

        async def sign_out(account: str) -> None:
            self.signed_out.append(account)

        self.rights.on_withdrawn(withdraw)
        self.own_sign_in.on_signed_out(sign_out)
        database.listen(notices.CHANNEL, self.rights.on_notice)
        database.listen(notices.CHANNEL, self.own_sign_in.on_notice)

    async def session(self, name: str) -> bytes:
        """Sign a user in."""
        hash_ = rules.secret_hash(f"session of {name}")
        now = self.sign_in._clock()
        await self.database.write(
            lambda c: store.begin_session(c, hash_, name, now, now + 3600, weak_secret=False)
        )
        return hash_


@pytest.fixture
async def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Elsewhere]:
    monkeypatch.setattr(rights, "WATCH_EVERY_S", 3600.0)
    async with _served(Database(tmp_path / "lineside.db")) as elsewhere:
        yield elsewhere


@asynccontextmanager
async def _served(database: Database) -> AsyncIterator[Elsewhere]:
    elsewhere = Elsewhere(database)
    await elsewhere.accounts.add_user("root", Role.ADMIN, PASSWORD, **BY)
    await elsewhere.accounts.add_user("ann", Role.ENGINEER, PASSWORD, **BY)
    await elsewhere.accounts.create_token("plc", Role.OPERATOR, **BY)
    watching = asyncio.create_task(elsewhere.rights.watch())
    await until(lambda: elsewhere.rights._standings, "the first look")
    yield elsewhere
    watching.cancel()
    database.close()


@pytest.mark.parametrize(
    ("change", "account"),
    [
        (lambda there: there.accounts.revoke_token("plc", **BY), "plc (token)"),
        (lambda there: there.accounts.set_role("ann", Role.VIEWER, **BY), "ann"),
        (lambda there: there.accounts.set_disabled("ann", True, **BY), "ann"),
        (lambda there: there.accounts.remove_user("ann", **BY), "ann"),
        (lambda there: there.accounts.set_password("ann", "another good one", **BY), "ann"),
    ],
)
async def test_a_withdrawn_right_ends_at_once(elsewhere: Elsewhere, change: Change, account: str) -> None:
    connection = asyncio.create_task(_open_connection(elsewhere, account))
    await until(lambda: elsewhere.rights.rechecks._open, "an open connection")
    await change(elsewhere)
    await until(lambda: elsewhere.withdrawn == [account], "the withdrawal")
    await connection


async def _open_connection(elsewhere: Elsewhere, account: str) -> None:
    """Ends with the first change."""

    async def is_allowed() -> bool:
        return False

    rechecks = elsewhere.rights.rechecks
    await rechecks.until_withdrawn(account, is_allowed, rechecks.count, every_s=3600.0)


async def test_the_end_of_the_last_session_is_known(elsewhere: Elsewhere) -> None:
    """Control of a line is given back at its home."""
    hash_ = await elsewhere.session("ann")
    connection = asyncio.create_task(_open_connection(elsewhere, "ann"))
    await until(lambda: elsewhere.rights.rechecks._open, "an open connection")
    await elsewhere.sign_in.end(hash_, "ann")
    await connection
    await until(lambda: elsewhere.signed_out == ["ann"], "the end of the last session")


async def test_who_has_signed_in_again_keeps_what_was_taken_since(elsewhere: Elsewhere) -> None:
    await elsewhere.session("ann")
    elsewhere.own_sign_in.on_notice("signed-out ann")
    await until(lambda: not elsewhere.own_sign_in._following, "the look at the sessions")
    assert elsewhere.signed_out == []


async def test_an_own_new_password_withdraws_nothing(elsewhere: Elsewhere) -> None:
    keep = await elsewhere.session("ann")
    ann = Person("ann", Role.ENGINEER, "session")
    read_at = elsewhere.rights._read_at
    await elsewhere.accounts.change_own_password("another good one", keep=keep, by=ann)
    await until(lambda: elsewhere.rights._read_at > read_at, "another look")
    assert elsewhere.withdrawn == []


async def test_lost_notices_are_made_up_for(elsewhere: Elsewhere) -> None:
    """The connection that listens was away: an empty text states that."""
    connection = asyncio.create_task(_open_connection(elsewhere, "ann"))
    await until(lambda: elsewhere.rights.rechecks._open, "an open connection")
    elsewhere.rights.on_notice("")
    elsewhere.own_sign_in.on_notice("")
    await connection


@pytest.mark.parametrize(
    ("text", "notice"),
    [
        ("changed ann", RightsNotice("changed", "ann")),
        ("changed plc (token)", RightsNotice("changed", "plc (token)")),
        ("kept ann", RightsNotice("kept", "ann")),
        ("signed-out ann", RightsNotice("signed-out", "ann")),
        ("", RightsNotice("changed")),
        ("of a later version", RightsNotice("changed")),
    ],
)
def test_a_notice_is_read(text: str, notice: RightsNotice) -> None:
    assert notices.read(text) == notice
