"""A PostgreSQL of one test, which the test stops, kills and starts again."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tests.e2e.limits import START_S
from tests.e2e.site import eventually
from tests.postgresql import OPTIONS, USER, binaries

DURABLE = {"fsync": "off", "synchronous_commit": "on"}
"""It may be killed, and the machine goes on."""


class OwnPostgresql:
    """Listens on a socket in ``folder``."""

    def __init__(self, folder: Path) -> None:
        programs = binaries()
        assert programs is not None
        self.folder = folder
        self._programs = programs
        # PostgreSQL refuses to run as root.
        self._user = "nobody" if os.geteuid() == 0 else None
        self._data = folder / "data"
        self._server: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"postgresql://{USER}@/postgres?host={self.folder}"

    def make(self) -> None:
        self._data.mkdir(mode=0o700)
        if self._user:
            shutil.chown(self.folder, self._user)
            shutil.chown(self._data, self._user)
        options = ("-U", USER, "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync", "--no-instructions")
        initdb = [self._programs / "initdb", "-D", self._data, *options]
        subprocess.run(initdb, check=True, user=self._user, cwd="/", stdout=subprocess.DEVNULL)

    def start(self, **more: str) -> None:
        """Returns once it takes connections. ``more``: settings of this run."""
        options = {**OPTIONS, **DURABLE, **more}
        words = [word for name, value in options.items() for word in ("-c", f"{name}={value}")]
        command = [self._programs / "postgres", "-D", self._data, "-k", self.folder, *words]
        with (self.folder / "log").open("ab") as log:
            self._server = subprocess.Popen(
                command, user=self._user, cwd="/", stdout=log, stderr=log, start_new_session=True
            )
        ready = [self._programs / "pg_isready", "-q", "-h", self.folder, "-p", options.get("port", "5432")]
        eventually(lambda: subprocess.run(ready).returncode == 0, "PostgreSQL", within=START_S)

    def signal(self, number: int) -> None:
        """Send a signal to it and to all that it has started."""
        assert self._server is not None
        for process in (self._server.pid, *self._children()):
            with suppress(ProcessLookupError):
                os.kill(process, number)

    def kill(self) -> None:
        """As a power failure ends it."""
        assert self._server is not None
        self.signal(signal.SIGKILL)
        self._server.wait()

    def stop_immediately(self) -> None:
        """``pg_ctl stop -m immediate``."""
        assert self._server is not None
        command = [self._programs / "pg_ctl", "stop", "-m", "immediate", "-D", self._data, "-s"]
        subprocess.run(command, check=True, user=self._user, cwd="/")
        self._server.wait()

    def _children(self) -> list[int]:
        assert self._server is not None
        found = Path(f"/proc/{self._server.pid}/task/{self._server.pid}/children").read_text()
        return [int(pid) for pid in found.split()]

    def end(self) -> None:
        if self._server is not None and self._server.poll() is None:
            self.signal(signal.SIGCONT)
            self.kill()


@contextmanager
def own_postgresql() -> Iterator[OwnPostgresql]:
    """One that is ready, and is gone afterwards."""
    # The path of a socket is short.
    folder = Path(tempfile.mkdtemp(prefix="lineside-pg-"))
    folder.chmod(0o755)
    server = OwnPostgresql(folder)
    try:
        server.make()
        server.start()
        yield server
    finally:
        server.end()
        shutil.rmtree(folder)
