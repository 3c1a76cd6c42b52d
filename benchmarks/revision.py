"""An earlier commit of this repository as a server that can be measured beside this one."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from pathlib import Path

from tests.e2e.site import end, eventually, unit_tables
from tests.free_port import free_port

TREE = Path(__file__).parents[1]
START_S = 60.0
COMPILED_S = 3.0
"""After the first page: until the catalogs of the other languages are compiled."""
ROLES = ("viewer", "operator")
CONFIG = "lineside.toml"
NO_PORT = "/dev/lineside-no-port"


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
        yield Revision(commit, Path(folder))


@dataclass(frozen=True)
class Store:
    """The folder of a site of a revision, with tokens of ROLES and of a worker of the bus ``line``."""

    revision: Revision
    folder: Path
    tokens: dict[str, str]

    @contextmanager
    def served(self, units: int, port: str) -> Iterator[Served]:
        """A server of it, from the moment that its process is started."""
        address, config = free_port(), self.folder / CONFIG
        config.write_text(_configuration(address, units, port), encoding="utf-8")
        process = subprocess.Popen(
            self.revision.called("app.cli", "serve", "--config", str(config)),
            env=self.revision.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield Served(self.revision, f"http://127.0.0.1:{address}", self.tokens, process)
        finally:
            end(process)


@contextmanager
def prepared(revision: Revision) -> Iterator[Store]:
    """A store with all that a first start leaves: modules, templates and catalogs are compiled."""
    modules = [revision.folder / name for name in ("app", "bus", "benchmarks")]
    subprocess.run([sys.executable, "-m", "compileall", "-q", *modules], check=True)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, CONFIG)
        config.write_text(_configuration(1, 1, NO_PORT), encoding="utf-8")
        store = Store(revision, Path(folder), revision.tokens(config))
        with store.served(1, NO_PORT) as server:
            wait_until_served(server)
            server.get("/")
            time.sleep(COMPILED_S)
        yield store


def wait_until_served(server: Served) -> None:
    """Until it serves."""
    eventually(lambda: server.get("/healthz") == 200, "a response of the server", within=START_S)


def _configuration(address: int, units: int, port: str) -> str:
    bus = f'[[bus]]\nname = "line"\nport = "{port}"\nturnaround_ms = 500\n'
    return f"[server]\nport = {address}\n\n{bus}{unit_tables(units)}"
