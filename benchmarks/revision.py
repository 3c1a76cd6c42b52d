"""An earlier commit of this repository as a server that can be measured beside this one."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from pathlib import Path

from tests.e2e.site import end, eventually, unit_tables
from tests.free_port import free_port

TREE = Path(__file__).parents[1]
START_S = 60.0
ROLES = ("viewer", "operator")


@dataclass(frozen=True)
class Revision:
    """A tree of this repository, run by the packages of this environment: what its own code costs differs,
    and not what a library's does."""

    name: str
    folder: Path

    @property
    def environment(self) -> dict[str, str]:
        return {**os.environ, "PYTHONPATH": str(self.folder)}

    def called(self, module: str, *arguments: str) -> list[str]:
        """The call of a module of this tree: ``app.cli`` is its command."""
        return [sys.executable, "-P", "-m", module, *arguments]

    def tokens(self, config: Path) -> dict[str, str]:
        """New tokens of the roles that are measured."""
        return {role: self._token(config, "--role", role) for role in ROLES} | {
            "worker": self._worker(config)
        }

    def _worker(self, config: Path) -> str:
        """The token of a feeder; an engineer's where no token was for one bus yet."""
        try:
            return self._token(config, "--role", "worker", "--bus", "line")
        except subprocess.CalledProcessError:
            return self._token(config, "--role", "engineer")

    def _token(self, config: Path, *options: str) -> str:
        called = self.called("app.cli", "token", "create", options[1], *options, "--config", str(config))
        done = subprocess.run(called, env=self.environment, check=True, capture_output=True, text=True)
        return done.stdout.split()[-1]


@dataclass(frozen=True)
class Served:
    """A server of a revision. ``process``: the app; its workers are children."""

    revision: Revision
    url: str
    tokens: dict[str, str]
    process: subprocess.Popen[bytes]

    def get(self, path: str) -> int | None:
        """The status of a request of the viewer; None while nothing responds."""
        connection = HTTPConnection(self.url.rpartition("/")[2], timeout=START_S)
        try:
            connection.request("GET", path, headers={"Authorization": f"Bearer {self.tokens['viewer']}"})
            return connection.getresponse().status
        except (OSError, HTTPException):
            return None
        finally:
            connection.close()


@contextmanager
def exported(commit: str) -> Iterator[Revision]:
    """The tree of a commit in a temporary folder. Raises CalledProcessError for an unknown one."""
    packed = subprocess.run(["git", "archive", commit], cwd=TREE, check=True, stdout=subprocess.PIPE).stdout
    with tempfile.TemporaryDirectory(prefix="lineside-revision-") as folder:
        with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
            archive.extractall(folder, filter="data")
        shutil.copytree(TREE / "static" / "vendor", Path(folder, "static", "vendor"))
        # Else the first of its servers alone would compile it.
        subprocess.run([sys.executable, "-m", "compileall", "-q", "app", "bus"], cwd=folder, check=True)
        yield Revision(commit, Path(folder))


@contextmanager
def served(revision: Revision, units: int, port: str) -> Iterator[Served]:
    """A new site at a port, from the moment its server is started."""
    with tempfile.TemporaryDirectory() as folder:
        config, address = Path(folder, "lineside.toml"), free_port()
        head = f'[server]\nport = {address}\n\n[[bus]]\nname = "line"\nport = "{port}"\nturnaround_ms = 500\n'
        config.write_text(head + unit_tables(units), encoding="utf-8")
        tokens = revision.tokens(config)
        process = subprocess.Popen(
            revision.called("app.cli", "serve", "--config", str(config)),
            env=revision.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield Served(revision, f"http://127.0.0.1:{address}", tokens, process)
        finally:
            end(process)


def wait_until_served(server: Served) -> None:
    """Until it serves."""
    eventually(lambda: server.get("/healthz") == 200, "a response of the server", within=START_S)
