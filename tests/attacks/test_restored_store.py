"""A store restored from a backup revives no right that was withdrawn since."""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Awaitable, Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from app.cli import cli
from app.core.database import Database
from app.core.web.access import Role
from app.line.commands.limits import CommandBlock, Limits, Restrictions
from app.people.audit.keys import open_keys
from app.people.audit.log import EventLog
from app.people.audit.proof import heads_of
from app.people.auth import store
from app.people.auth.accounts import Accounts
from app.people.auth.store import CompanyAccount
from app.settings import load
from tests.administrator import BY

PASSWORD, OTHER_PASSWORD = "correct horse battery", "wrong horse battery"


class Plant:
    """A data folder with a store, and the commands on it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = folder / "lineside.toml"
        self.config.write_text('[server]\ndata = "data"\n')
        self.store = folder / "data" / "lineside.db"
        self.backup = folder / "monday.tar"

    def change(self, work: Callable[[Accounts, Database], Awaitable[None]]) -> None:
        database = Database(self.store)

        async def run() -> None:
            keys = open_keys(load(self.config).key_files, self.store, await database.read(heads_of))
            await work(Accounts(database, EventLog(database, keys=keys)), database)

        asyncio.run(run())
        database.close()

    def command(self, *arguments: str) -> Result:
        return CliRunner().invoke(cli, [*arguments, "--config", str(self.config)])

    def back_up(self) -> None:
        assert self.command("backup-store", str(self.backup)).exit_code == 0

    def restore(self) -> str:
        done = self.command("restore-store", str(self.backup), "--yes")
        assert done.exit_code == 0, done.stderr
        return done.stdout

    def rows(self, query: str) -> list[Any]:
        with closing(sqlite3.connect(self.store)) as connection:
            return [row if len(row) > 1 else row[0] for row in connection.execute(query)]


async def people(accounts: Accounts, database: Database) -> None:
    """An admin, three engineers who may sign in, and two programs; one of the engineers has."""
    await accounts.add_user("boss", Role.ADMIN, PASSWORD, **BY)
    for name in ("ann", "ben", "cid"):
        await accounts.add_user(name, Role.ENGINEER, PASSWORD, **BY)
    for name in ("kept", "stolen"):
        await accounts.create_token(name, Role.ENGINEER, **BY)
    await database.write(
        lambda connection: store.begin_session(connection, b"s", "ann", 1.0, 9e9, weak_secret=False)
    )


async def withdrawals(accounts: Accounts, database: Database) -> None:
    """What happens between the backup and its use."""
    await accounts.revoke_token("stolen", **BY)
    await accounts.remove_user("ann", **BY)
    await accounts.set_role("ben", Role.VIEWER, **BY)
    await accounts.set_disabled("cid", True, **BY)
    await accounts.set_password("boss", OTHER_PASSWORD, **BY)
    assert database.path.exists()


@pytest.fixture
def plant(tmp_path: Path) -> Plant:
    made = Plant(tmp_path)
    made.change(people)
    made.back_up()
    return made


def test_what_was_withdrawn_since_stays_so(plant: Plant) -> None:
    plant.change(withdrawals)
    [present] = plant.rows("SELECT secret_hash FROM users WHERE name = 'boss'")
    output = plant.restore()
    assert plant.rows("SELECT count(*) FROM sessions") == [0]
    assert plant.rows("SELECT name FROM tokens") == ["kept"]
    assert plant.rows("SELECT name, role, disabled FROM users ORDER BY name") == [
        ("ann", "engineer", 1),
        ("ben", "viewer", 0),
        ("boss", "admin", 0),
        ("cid", "engineer", 1),
    ]
    assert plant.rows("SELECT secret_hash FROM users WHERE name = 'boss'") == [present]
    for words in (
        "every session has ended",
        "tokens revoked: stolen",
        "users disabled, as they are or were removed now: ann, cid",
        "users with the lower role of now: ben",
    ):
        assert words in output


def test_a_company_account_gets_no_user_of_the_same_name(plant: Plant) -> None:
    """Nor the other way round: a name alone is no person."""
    account = CompanyAccount("https://login.plant.example", "1")

    async def changes(accounts: Accounts, _: Database) -> None:
        for name in ("ann", "ben"):
            await accounts.remove_user(name, **BY)
        await accounts.follow_provider(account, "ann", Role.ADMIN, address="192.0.2.7")

    plant.change(changes)
    output = plant.restore()
    assert plant.rows("SELECT name, disabled, issuer FROM users WHERE name = 'ann'") == [("ann", 1, None)]
    assert "users disabled, as they are or were removed now: ann, ben" in output


def test_an_event_names_who_restored_which_backup(plant: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("getpass.getuser", lambda: "root")
    plant.change(withdrawals)
    plant.restore()
    [(who, origin, what, message)] = plant.rows(
        "SELECT who, origin, what, message FROM events WHERE kind = 'server'"
    )
    assert (who, origin, what) == ("root", "command line", "the stores were restored from a backup")
    assert message.startswith("monday.tar of 20")
    assert "SHA-256" in message
    assert message.endswith("users with the lower role of now: ben")
    assert plant.command("audit", "verify").exit_code == 0


@pytest.mark.parametrize("present", ["absent", "damaged", "without users"])
def test_with_unknown_revocations_every_token_is_revoked(plant: Plant, present: str) -> None:
    plant.store.unlink()
    if present == "damaged":
        plant.store.write_bytes(b"SQLite format 3\0" + b"rubbish" * 1000)
    if present == "without users":
        Database(plant.store).close()
    output = plant.restore()
    assert plant.rows("SELECT count(*) FROM tokens") == [0]
    assert plant.rows("SELECT count(*) FROM sessions") == [0]
    assert plant.rows("SELECT name FROM users WHERE NOT disabled ORDER BY name") == [
        "ann",
        "ben",
        "boss",
        "cid",
    ]
    assert "tokens revoked: kept, stolen" in output


def test_a_stranger_in_the_present_store_does_not_survive(plant: Plant) -> None:
    async def intrude(accounts: Accounts, _: Database) -> None:
        await accounts.add_user("intruder", Role.ADMIN, PASSWORD, **BY)
        await accounts.create_token("intruder", Role.ADMIN, **BY)
        await accounts.set_role("ann", Role.ADMIN, **BY)

    plant.change(intrude)
    plant.restore()
    assert plant.rows("SELECT name FROM users WHERE role = 'admin'") == ["boss"]
    assert plant.rows("SELECT name FROM tokens ORDER BY name") == ["kept", "stolen"]


def test_a_panel_made_in_the_place_of_a_person_gives_the_person_no_pin(plant: Plant) -> None:
    async def replace(accounts: Accounts, _: Database) -> None:
        await accounts.remove_user("ann", **BY)
        await accounts.add_panel("ann", Role.VIEWER, "471193", "/", **BY)

    plant.change(replace)
    plant.restore()
    assert plant.rows("SELECT panel, disabled FROM users WHERE name = 'ann'") == [(0, 1)]


def test_without_an_admin_it_prints_how_to_make_one(plant: Plant) -> None:
    async def leave(accounts: Accounts, _: Database) -> None:
        await accounts.add_user("new", Role.ADMIN, PASSWORD, **BY)
        await accounts.remove_user("boss", **BY)

    plant.change(leave)
    assert "no admin can sign in; add one with 'lineside user add'" in plant.restore()


def test_blocks_and_limits_of_now_stay_in_force(plant: Plant) -> None:
    async def protect(_: Accounts, database: Database) -> None:
        await Restrictions(database, "dry-end").put_block(2, CommandBlock("belt off", "ann", 1.0))
        await Restrictions(database, "dry-end").put_limits(2, Limits(highest=500), "ann", 1.0)

    plant.change(protect)
    plant.restore()
    assert plant.rows("SELECT bus, unit, reason FROM blocks") == [("dry-end", 2, "belt off")]
    assert plant.rows("SELECT bus, unit, highest FROM limits") == [("dry-end", 2, 500)]


def test_a_backup_of_a_newer_version_replaces_nothing(plant: Plant) -> None:
    with closing(sqlite3.connect(plant.store)) as connection:
        connection.execute("INSERT INTO migrations VALUES (9999, 'of_tomorrow', 1.0)")
        connection.commit()
    plant.backup.unlink()
    plant.back_up()
    before = plant.store.read_bytes()
    done = plant.command("restore-store", str(plant.backup), "--yes")
    assert (done.exit_code, "newer version" in done.stderr) == (1, True)
    assert plant.store.read_bytes() == before
