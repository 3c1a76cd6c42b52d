"""``lineside serve`` with ``[server.tls]`` as a process, and clients of it."""

from __future__ import annotations

import shutil
import ssl
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from tests import fork_server
from tests.certificates import certificates
from tests.e2e.site import end, eventually, people
from tests.fork_server import ForkedProcess
from tests.free_port import free_port

PATIENCE_S = 60.0
CONFIG = """\
[server]
port = {port}
data = "data"
[server.tls]
certificate = "server.pem"
key = "server.key"
{more}
[[bus]]
name = "dry-end"
port = "/nowhere/tty"
[[bus.unit]]
id = 1
name = "Unwind"
"""


def seen(log: Path, *texts: str) -> None:
    """Wait until a log has one of these texts."""
    try:
        eventually(lambda: any(text in log.read_text() for text in texts), " or ".join(texts))
    except AssertionError as error:
        raise AssertionError(f"{error}; the log is {log.read_text()[-1500:]}") from None


@dataclass
class Served:
    folder: Path
    port: int
    server: ForkedProcess
    tokens: dict[str, str] = field(default_factory=dict)

    @property
    def url(self) -> str:
        return f"https://localhost:{self.port}"

    @property
    def context(self) -> ssl.SSLContext:
        return ssl.create_default_context(cafile=self.folder / "ca.pem")

    def client(self, role: str = "") -> httpx.Client:
        headers = {"Authorization": f"Bearer {self.tokens[role]}"} if role else {}
        options: Any = {"headers": headers, "trust_env": False, "timeout": PATIENCE_S}
        return httpx.Client(base_url=self.url, verify=self.context, **options)

    def log(self) -> str:
        return (self.folder / "serve.log").read_text()


@contextmanager
def served(folder: Path, more: str = "") -> Iterator[Served]:
    certificates(folder)
    config, port = folder / "lineside.toml", free_port()
    config.write_text(CONFIG.format(port=port, more=more))
    data, tokens = people()
    shutil.copytree(data, folder / "data")
    with (folder / "serve.log").open("ab") as log:
        server = fork_server.start("serve", "--config", config, stdout=log, stderr=log)
    made = Served(folder, port, server, tokens)
    try:
        eventually(lambda: "Lineside: https://" in made.log() or server.poll() is not None, "it serves")
        assert server.poll() is None, made.log()
        yield made
    finally:
        end(server)
