"""The ways in which an engineer loses the right to what is under way."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Awaitable, Callable
from contextlib import closing
from pathlib import Path

from app.core.web.access import Role
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from tests.administrator import BY
from tests.app.complete_app import PASSWORD, House

ENGINEER = "the-engineer"
Withdraw = Callable[[House, Path], Awaitable[None]]


async def disabled(house: House, _: Path) -> None:
    await house.services[Accounts].set_disabled(ENGINEER, True, **BY)


async def removed(house: House, _: Path) -> None:
    await house.services[Accounts].remove_user(ENGINEER, **BY)


async def demoted(house: House, _: Path) -> None:
    await house.services[Accounts].set_role(ENGINEER, Role.OPERATOR, **BY)


async def given_another_password(house: House, _: Path) -> None:
    await house.services[Accounts].set_password(ENGINEER, "x" + PASSWORD, **BY)


async def replaced_by_a_namesake(house: House, _: Path) -> None:
    await removed(house, _)
    await house.add(ENGINEER, Role.ENGINEER)


async def disabled_by_another_process(house: House, folder: Path) -> None:
    in_another_process(folder, f"UPDATE users SET disabled = 1 WHERE name = '{ENGINEER}'")
    await noticed(house)


async def removed_by_another_process(house: House, folder: Path) -> None:
    in_another_process(folder, f"DELETE FROM users WHERE name = '{ENGINEER}'")
    await noticed(house)


def in_another_process(folder: Path, change: str) -> None:
    """As the command line does: by a connection that the server knows nothing of."""
    with closing(sqlite3.connect(folder / "data" / "lineside.db", timeout=20)) as store:
        store.execute(change)
        store.commit()


async def noticed(house: House) -> None:
    """Wait until the server has checked the store."""
    event = asyncio.Event()

    async def notice(_: str) -> None:
        event.set()

    house.services[Rights].on_withdrawn(notice)
    async with asyncio.timeout(60):
        await event.wait()
