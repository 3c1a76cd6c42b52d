"""Rights that end in another process, or by themselves, are noticed once."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from app.core.database import Database
from app.core.web.access import Role
from app.people.audit.log import EventLog
from app.people.auth import rules
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from tests.administrator import BY

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
        for store in self.stores:
            store.close()


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
