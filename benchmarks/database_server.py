"""A PostgreSQL for a benchmark: each setting at its default, and the CPU time that it takes."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from app.database.settings import StoreSettings
from tests.postgresql import binaries

USER = "lineside"
START_S = 30.0
TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class DatabaseServer:
    """A server that runs. ``process`` is its first process, the parent of all others."""

    folder: Path
    process: subprocess.Popen[bytes]

    def store(self, name: str) -> StoreSettings:
        """A new database of this name."""
        import psycopg

        with psycopg.connect(self._url("postgres"), autocommit=True) as server:
            server.execute(f'CREATE DATABASE "{name}"'.encode())
        return StoreSettings(url=self._url(name))

    def cpu_s(self) -> float:
        """CPU time of all its processes, also of those that have ended."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        ticks = sum(_ticks(self.process.pid)) + sum(sum(_ticks(int(child))[:2]) for child in children)
        return ticks / TICKS_A_SECOND

    def _url(self, name: str) -> str:
        return f"postgresql://{USER}@/{name}?host={self.folder}"


def _ticks(process: int) -> tuple[int, ...]:
    """User, system, and the same of children that have ended (proc_pid_stat(5))."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0, 0, 0, 0
    return tuple(map(int, fields[11:15]))


@contextmanager
def database_server() -> Iterator[DatabaseServer]:
    """Start one in a new folder; afterwards nothing of it is left."""
    programs = binaries()
    assert programs is not None, "PostgreSQL is not installed (Debian: postgresql)"
    folder = Path(tempfile.mkdtemp(prefix="lineside-database-"))
    user = "postgres" if os.geteuid() == 0 else None
    if user:
        shutil.chown(folder, user)
    initialize = [programs / "initdb", "-U", USER, "-A", "trust", "-E", "UTF8", "-D", folder / "data"]
    subprocess.run(initialize, check=True, user=user, cwd="/", stdout=subprocess.DEVNULL)
    words = [programs / "postgres", "-D", folder / "data", "-k", folder, "-c", "listen_addresses="]
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(words, user=user, cwd="/", stdout=log, stderr=log)
    try:
        ready = [programs / "pg_isready", "-q", "-h", folder]
        end = time.monotonic() + START_S
        while subprocess.run(ready).returncode:
            assert time.monotonic() < end, (folder / "log").read_text()
            time.sleep(0.1)
        yield DatabaseServer(folder, process)
    finally:
        process.terminate()
        process.wait()
        shutil.rmtree(folder)
