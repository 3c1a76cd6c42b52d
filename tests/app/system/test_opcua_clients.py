"""The OPC UA server as clients of other makers see it: node-opcua, and gopcua."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from tests.app.opcua import SECRET, TOKEN, OpcuaServer, client_certificate, responds, scales

ROOT = Path(__file__).resolve().parents[3]
SOURCES = Path(__file__).parents[1]
PARTS = {"Identification", "Speed", "Inputs", "Outputs", "Link", "Alarms", "Parameters"}
GOPCUA = "v0.8.0"


@dataclass
class Line:
    """A server with a unit that responds all the time since ``began``; ``client``: the folder of a client
    that is trusted."""

    server: OpcuaServer
    client: Path
    uri: str
    began: float

    async def look(self, *program: str, secret: str = SECRET) -> dict[str, Any]:
        """Run a client to its end; return what it found."""
        words = (*program, self.server.url, str(self.client), TOKEN, secret, self.uri)
        process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
        text, _ = await process.communicate()
        found: dict[str, Any] = json.loads(text.splitlines()[-1])
        return found


@pytest.fixture
async def line(tmp_path: Path) -> AsyncIterator[Line]:
    client, server = client_certificate(tmp_path / "client"), OpcuaServer(tmp_path / "server")
    server.trust(client)
    async with server.running(), responding(server):
        yield Line(server, tmp_path / "client", client.uri, time.time())


@asynccontextmanager
async def responding(server: OpcuaServer) -> AsyncIterator[None]:
    async def respond() -> None:
        server.report(*scales(1, time.time()))
        while True:
            server.report(*responds(1, time.time()))
            await asyncio.sleep(0.25)

    task = asyncio.create_task(respond())
    yield
    task.cancel()


async def test_node_opcua_reads_the_line(line: Line) -> None:
    node = shutil.which("node")
    if node is None or not (ROOT / "node_modules" / "node-opcua-client").exists():
        pytest.skip("the client is a package of Node, which make development installs")
    found = await line.look(node, str(SOURCES / "opcua_client.mjs"))
    assert "error" not in found, found
    assert found["actual"] == [123.4, "Good", "Double"]
    assert datetime.fromisoformat(found["at"]).timestamp() > line.began - 60
    assert found["unit"] == ["m/min", 12888]
    assert found["unread"] == "BadWaitingForInitialData"
    assert found["serial"] == "4711"
    assert set(found["parts"]) >= PARTS
    assert found["subscribed"] == 123.4
    assert found["write"] == "BadNotWritable"


@pytest.mark.soak
async def test_gopcua_reads_the_line(line: Line, tmp_path: Path) -> None:
    """Its module is fetched, and built in a minute."""
    go = shutil.which("go") or shutil.which("go", path="/usr/local/go/bin")
    if go is None:
        pytest.skip("Go is not installed")
    program = await _built(go, tmp_path / "go")
    found = await line.look(str(program))
    assert "error" not in found, found
    assert found["actual"] == [123.4, 0]
    assert "BadWaitingForInitialData" in found["unread"]
    assert set(found["parts"]) >= PARTS
    assert found["subscribed"] == 123.4
    assert "BadNotWritable" in found["write"]
    assert "error" in await line.look(str(program), secret="wrong")


async def _built(go: str, folder: Path) -> Path:
    _write_module(folder)
    environment = {**os.environ, "GOFLAGS": "-mod=mod"}
    process = await asyncio.create_subprocess_exec(
        go, "build", "-o", "client", ".", cwd=folder, env=environment, stderr=asyncio.subprocess.PIPE
    )
    _, complaint = await process.communicate()
    if process.returncode:
        pytest.skip(f"gopcua cannot be built: {complaint.decode(errors='replace')[-300:]}")
    return folder / "client"


def _write_module(folder: Path) -> None:
    folder.mkdir()
    shutil.copy(SOURCES / "opcua_client.go", folder / "main.go")
    (folder / "go.mod").write_text(f"module client\n\ngo 1.23\n\nrequire github.com/gopcua/opcua {GOPCUA}\n")
