"""The command line on a site whose store is PostgreSQL: whose database it is, and what is there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner

from app.audit.proof.keyring import KeyOrigin
from app.audit.proof.keys import make_key_file
from app.cli import cli
from app.database.settings import StoreSettings
from tests import fork_server
from tests.postgresql import fresh_database, needs_postgresql

pytestmark = needs_postgresql


@pytest.fixture
def store() -> Iterator[StoreSettings]:
    with fresh_database() as settings:
        yield settings


def site(folder: Path, store: StoreSettings) -> Path:
    """The configuration of a site whose audit key is beside it once it was made."""
    folder.mkdir(exist_ok=True)
    config = folder / "lineside.toml"
    config.write_text(f"[server]\nport = 0\n[store]\nurl = '{store.url}'\n")
    return config


def run(config: Path, *words: str, code: int = 0, stdin: str = "") -> str:
    result = CliRunner().invoke(cli, [*words, "--config", str(config)], input=stdin)
    assert result.exit_code == code, (result.output, result.exception)
    return result.output + str(result.exception or "")


def add_user(config: Path, code: int = 0) -> str:
    return run(config, "user", "add", "anna", "--role", "admin", "--password-stdin", code=code, stdin=SECRET)


SECRET = "correct horse battery\n"


def test_a_second_server_needs_the_key_of_the_site_and_another_site_another_database(
    tmp_path: Path, store: StoreSettings
) -> None:
    first = site(tmp_path / "first", store)
    add_user(first)
    assert "the audit log is intact" in run(first, "audit", "verify")
    assert "0 alarms came" in run(first, "report", "--shift", "now")
    without = site(tmp_path / "second", store)
    assert "a site lives in the database of [store], and its audit key is not here" in add_user(without, 1)
    make_key_file(without.with_name("lineside.audit.key"), KeyOrigin())
    assert "another site lives there, or the key was rotated" in add_user(without, 1)
    served = fork_server.run("serve", "--config", without)
    assert (served.returncode, "another site lives there" in served.stderr) == (1, True), served.stderr
    without.with_name("lineside.audit.key").write_bytes(first.with_name("lineside.audit.key").read_bytes())
    assert "anna" in run(without, "user", "list")


def test_the_key_of_a_site_does_not_start_on_an_empty_database(tmp_path: Path) -> None:
    with fresh_database(empty=True) as empty:
        config = site(tmp_path, empty)
    make_key_file(config.with_name("lineside.audit.key"), KeyOrigin())
    refusal = add_user(config, 1)
    assert "no site lives in the database postgresql://" in refusal
    assert "pg_restore" in refusal
    assert "no site lives in the database" in run(config, "check", code=1)


def test_files_of_sqlite_are_not_taken_for_the_store(tmp_path: Path, store: StoreSettings) -> None:
    config = site(tmp_path, store)
    assert "use pg_dump" in run(config, "backup-store", str(tmp_path / "b"), code=1)
    assert "use pg_restore" in run(config, "restore-store", str(tmp_path / "b"), "--yes", code=1)
