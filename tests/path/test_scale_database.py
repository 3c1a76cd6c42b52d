"""The PostgreSQL of ``docs/scale.md``, set up and put back by the commands and settings that stand there."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pytest

from app.database.opening import open_database
from app.database.settings import StoreSettings
from app.errors import StoreUnavailableError
from tests.certificates import certificates
from tests.free_port import free_port
from tests.postgresql import binaries, needs_postgresql
from tests.test_architecture import ROOT, text_of

PROGRAMS = binaries() or Path()
TEXT = text_of(ROOT / "docs" / "scale.md")
BLOCKS = {kind: re.findall(rf"```{kind}\n(.*?)```", TEXT, re.S) for kind in ("ini", "sh", "toml")}
FOLDERS = ("/var/backups/lineside", "/etc/lineside/certificates", "/var/lib/postgresql/15/main")
AS_POSTGRES = "sudo -u postgres "
PATIENCE_S = 60.0
COUNT = "SELECT count(*) FROM written"

pytestmark = [
    pytest.mark.skipif(os.geteuid() != 0, reason="only root starts PostgreSQL as its user"),
    needs_postgresql,
]


def block(kind: str, holds: str) -> str:
    """The one block of the page that has a text."""
    (found,) = (each for each in BLOCKS[kind] if holds in each)
    return str(found)


@dataclass
class DocumentedDatabase:
    """A PostgreSQL whose folders are below ``root``."""

    root: Path
    port: int

    @property
    def data(self) -> Path:
        return self.root / FOLDERS[2][1:]

    def below(self, text: str) -> str:
        for folder in FOLDERS:
            text = text.replace(folder, f"{self.root}{folder}")
        return text

    def typed(self, holds: str, **given: str) -> None:
        """Run the commands of a block as the page has them."""
        for line in self.below(block("sh", holds)).splitlines():
            words = shlex.split(line.removeprefix(AS_POSTGRES))
            environment = {
                "PGHOST": str(self.root),
                "PGPORT": str(self.port),
                "PATH": f"{PROGRAMS}:/usr/sbin:{os.defpath}",
            }
            done = self.run(*words, env=environment, input=given.get(words[0]))
            assert done.returncode == 0, (line, done.stderr)

    def run(self, *words: str | Path, **options: object) -> subprocess.CompletedProcess[str]:
        as_user = ("runuser", "-u", "postgres", "--", *map(str, words))
        # Without a terminal, createuser reads the password from its input.
        return subprocess.run(  # type: ignore[call-overload,no-any-return]
            as_user, cwd="/", capture_output=True, text=True, start_new_session=True, **options
        )

    def control(self, *words: str) -> None:
        options = f"-k {self.root} -p {self.port}"
        log = self.root / "log"
        done = self.run(PROGRAMS / "pg_ctl", "-w", "-D", self.data, "-l", log, "-o", options, *words)
        assert done.returncode == 0, log.read_text()

    def sql(self, statement: str, database: str = "lineside") -> str:
        place = ("-h", self.root, "-p", str(self.port), "-d", database)
        done = self.run(PROGRAMS / "psql", "-X", "-A", "-t", *place, "-c", statement)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()


@pytest.fixture(scope="module")
def database() -> Iterator[DocumentedDatabase]:
    # The folders of pytest belong to the user of the tests alone.
    root = Path(tempfile.mkdtemp(prefix="lineside-documented-"))
    made = DocumentedDatabase(root, free_port())
    for folder in (*FOLDERS, "/var/backups/lineside/wal"):
        made.root.joinpath(folder[1:]).mkdir(parents=True)
    certificates(root / FOLDERS[1][1:])
    shutil.rmtree(made.data)
    for path in (root, *root.rglob("*")):
        shutil.chown(path, "postgres")
    words = ("-A", "trust", "--no-sync", "--no-instructions", "-D", made.data)
    assert made.run(PROGRAMS / "initdb", *words).returncode == 0
    # There is no standby here, and no one waits for the disk.
    settings = made.below(block("ini", "archive_command")).replace("ANY 1 (*)", "")
    (made.data / "postgresql.conf").write_text(f"{settings}\nfsync = off\n")
    rules = block("ini", "hostssl").replace("10.0.0.0/24", "127.0.0.1/32")
    (made.data / "pg_hba.conf").write_text(
        f"local all postgres trust\nlocal replication postgres trust\n{rules}"
    )
    made.control("start")
    try:
        made.typed("createuser", createuser="secret\nsecret\n")
        yield made
    finally:
        made.control("stop", "-m", "immediate")
        shutil.rmtree(root)


def url_of(database: DocumentedDatabase, **changed: str) -> StoreSettings:
    """The URL of the page, at the place of this test."""
    (url,) = re.findall(r'url = "(.*)"', block("toml", "[store]"))
    url = database.below(url).replace("db-1.plant.example,db-2.plant.example", "localhost")
    url = url.replace("lineside@localhost/", f"lineside@localhost:{database.port}/")
    for old, new in changed.items():
        url = url.replace(old, new)
    password = database.root / "db.password"
    password.write_text("secret\n")
    return StoreSettings(url=url, password_file=password)


def test_the_url_encrypts_and_verifies(database: DocumentedDatabase) -> None:
    with closing(
        open_database(url_of(database), Path("history.db"), ROOT / "app/history/migrations")
    ) as store:
        query = "SELECT ssl FROM pg_stat_ssl WHERE pid = pg_backend_pid()"
        (encrypted,) = store.read_now(lambda connection: connection.execute(query).fetchone())
        assert encrypted
    for wrong in ({"localhost": "127.0.0.2"}, {"ca.pem": "other.pem"}, {"verify-full": "disable"}):
        with pytest.raises(StoreUnavailableError):
            open_database(url_of(database, **wrong), Path("history.db"))


def test_a_point_in_time_comes_back(database: DocumentedDatabase) -> None:
    database.sql("CREATE TABLE written AS SELECT 1 AS number")
    database.typed("pg_basebackup")
    database.sql("INSERT INTO written VALUES (2)")
    moment = datetime.now(UTC)
    time.sleep(0.01)
    database.sql("INSERT INTO written VALUES (3)")
    assert database.sql(COUNT) == "3"
    segment = database.sql("SELECT pg_walfile_name(pg_switch_wal())")
    archived = database.root / "var/backups/lineside/wal" / segment
    end = time.monotonic() + PATIENCE_S
    while not archived.exists():
        assert time.monotonic() < end, "the segment is not archived"
        time.sleep(0.05)
    database.control("stop", "-m", "fast")
    shutil.rmtree(database.data)
    database.run("mkdir", "-m", "0700", database.data)
    database.typed("recovery.signal")
    recovery = database.below(block("ini", "recovery_target_time"))
    stated = re.search(r"recovery_target_time = '(.*)'", recovery)
    assert stated is not None
    assert datetime.fromisoformat(stated[1]).tzinfo is not None
    with (database.data / "postgresql.conf").open("a") as settings:
        settings.write(recovery.replace(stated[1], moment.isoformat(sep=" ")))
    database.control("start")
    end = time.monotonic() + PATIENCE_S
    while database.sql("SELECT pg_is_in_recovery()") != "f":
        assert time.monotonic() < end, "it is still recovering"
        time.sleep(0.05)
    assert database.sql(COUNT) == "2"
