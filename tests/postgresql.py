"""One PostgreSQL for all tests that run at the same time, and an empty database for each test that wants one.

The first process starts it, in a process beside the tests: it serves until the last of them has ended, also
where they are killed. It keeps nothing, and never waits for the disk.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import count
from pathlib import Path

import pytest

from tests.fork_server import RUN

ROOT = Path(__file__).parents[1]
USER = "lineside"
GUARDED = "guarded"
"""A user who needs the password `PASSWORD`."""
PASSWORD = "correct horse battery"
START_S = 60.0
OPTIONS = {
    "fsync": "off",
    "synchronous_commit": "off",
    "full_page_writes": "off",
    "autovacuum": "off",
    "max_connections": "200",
    "shared_buffers": "32MB",
    "max_wal_size": "256MB",
    "wal_level": "minimal",
    "max_wal_senders": "0",
    "listen_addresses": "",
    "jit": "off",
}
_numbers = count()


def binaries() -> Path | None:
    """Where the programs of the newest PostgreSQL of this machine are."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/postgres"), key=lambda path: int(path.parts[4]))
    return found[-1].parent if found else None


def unusable() -> str:
    """Why no test can use PostgreSQL here; empty where tests can."""
    if binaries() is None:
        return "PostgreSQL is not installed (Debian: postgresql)"
    try:
        import psycopg  # noqa: F401
    except ImportError:
        return "psycopg is not installed"
    return ""


needs_postgresql = pytest.mark.skipif(bool(unusable()), reason=unusable())


@cache
def socket_folder() -> Path:
    """The folder of the socket on which the PostgreSQL of this run of the tests listens; it is started first
    where no process of the run has done that."""
    folder = Path(tempfile.gettempdir(), f"lineside-postgresql-{RUN}")
    folder.mkdir(mode=0o755, exist_ok=True)
    with (folder / "starting").open("a") as starting:
        fcntl.flock(starting, fcntl.LOCK_EX)
        _hold(folder)
        if not (folder / "ready").exists():
            _start(folder)
    return folder


_held: list[object] = []


def _hold(folder: Path) -> None:
    """Held by all processes that use it, to the end of each: the kernel ends it for one that is killed."""
    users = (folder / "users").open("a")
    fcntl.flock(users, fcntl.LOCK_SH)
    _held.append(users)


def _start(folder: Path) -> None:
    command = [sys.executable, "-m", "tests.postgresql", str(folder)]
    with (folder / "log").open("ab") as log:
        # Not waited for: it ends after this process.
        _held.append(
            subprocess.Popen(
                command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
        )
    end = time.monotonic() + START_S
    while not (folder / "ready").exists():
        if time.monotonic() > end:
            raise RuntimeError((folder / "log").read_text())
        time.sleep(0.02)


def url_of(database: str) -> str:
    return f"postgresql://{USER}@/{database}?host={socket_folder()}"


@contextmanager
def fresh_database() -> Iterator[str]:
    """The URL of an empty database, which goes when PostgreSQL ends."""
    import psycopg

    name = f"test_{os.getpid()}_{next(_numbers)}"
    with psycopg.connect(url_of("postgres"), autocommit=True) as server:
        server.execute(f'CREATE DATABASE "{name}" TEMPLATE template0 STRATEGY file_copy'.encode())
    yield url_of(name)


def _user() -> str | None:
    """PostgreSQL refuses to run as root."""
    return "nobody" if os.geteuid() == 0 else None


def _initialized(folder: Path) -> Path:
    """The data of a new PostgreSQL, in a folder that its user has from now on."""
    data, user = folder / "data", _user()
    data.mkdir(mode=0o700)
    if user:
        shutil.chown(data, user)
        shutil.chown(folder, user)
    initialize = f"{binaries()}/initdb -U {USER} -A trust -E UTF8 --locale=C --no-sync --no-instructions -D"
    subprocess.run([*initialize.split(), data], check=True, user=user, cwd="/", stdout=subprocess.DEVNULL)
    rules = data / "pg_hba.conf"
    rules.write_text(f"local all {GUARDED} scram-sha-256\n{rules.read_text()}")
    return data


def _started(folder: Path, data: Path) -> subprocess.Popen[bytes]:
    options = [word for name, value in OPTIONS.items() for word in ("-c", f"{name}={value}")]
    words = [f"{binaries()}/postgres", "-D", data, "-k", folder, *options]
    return subprocess.Popen(words, user=_user(), cwd="/", stderr=subprocess.DEVNULL)


class OwnPostgresql:
    """A PostgreSQL of one test, which may be killed and started again."""

    def __init__(self) -> None:
        # The path of a socket is short, and the user must be able to enter each folder above.
        self._folder = Path(tempfile.mkdtemp(prefix="lineside-own-", dir="/tmp"))
        self._folder.chmod(0o755)
        self._data = _initialized(self._folder)
        self.url = f"postgresql://{USER}@/postgres?host={self._folder}"
        self.start()

    def start(self) -> None:
        """Start it, and wait until it takes connections."""
        import psycopg

        self._process = _started(self._folder, self._data)
        end = time.monotonic() + START_S
        while True:
            try:
                psycopg.connect(self.url).close()
                return
            except psycopg.OperationalError:
                if time.monotonic() > end:
                    raise
                time.sleep(0.02)

    def kill(self) -> None:
        """End it in the midst of everything."""
        self._process.send_signal(signal.SIGQUIT)
        self._process.wait()

    def close(self) -> None:
        self.kill()
        shutil.rmtree(self._folder)


def serve(folder: Path) -> None:
    """Start PostgreSQL, serve while a test uses it, remove everything."""
    server = _started(folder, _initialized(folder))
    try:
        _make_guarded_user(folder)
        (folder / "ready").touch()
        with (folder / "users").open("a") as users:
            fcntl.flock(users, fcntl.LOCK_EX)
    finally:
        server.terminate()
        server.wait()
        shutil.rmtree(folder)


def _make_guarded_user(folder: Path) -> None:
    """Make `GUARDED`, once PostgreSQL takes connections."""
    import psycopg

    end = time.monotonic() + START_S
    while True:
        try:
            with psycopg.connect(f"postgresql://{USER}@/postgres?host={folder}", autocommit=True) as server:
                server.execute(f"CREATE ROLE {GUARDED} LOGIN SUPERUSER PASSWORD '{PASSWORD}'".encode())
            return
        except psycopg.OperationalError:
            if time.monotonic() > end:
                raise
            time.sleep(0.02)


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
