"""A site that serves OPC UA: the process follows its live state, is started again, and is shown."""

from __future__ import annotations

import asyncio
import importlib.util
import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest
from asyncua import Client, ua

from app.cli.check import opcua
from app.core.database import Database
from app.core.web.access import Role
from app.line.alarms.line_alarms import SiteAlarms
from app.people.auth import store
from app.people.auth.rules import secret_hash
from app.people.auth.store import Token
from app.settings import load
from app.system.opcua.process import OpcuaProcess
from app.system.opcua.settings import OpcuaProcesses
from bus.instants import UnixTime
from bus.messages import in_english
from tests.app.complete_app import House, complete_app
from tests.app.fake_worker import PlayedWorker, reading, until
from tests.app.opcua import SECRET, TOKEN, OpcuaServer, client_certificate, connected
from tests.free_port import free_port

UNITS = "".join(f'[[bus.unit]]\nid = {n}\nname = "Unit {n}"\n' for n in (1, 2, 16))


def configuration(folder: Path, port: int) -> Path:
    folder.mkdir(exist_ok=True)
    config = folder / "lineside.toml"
    config.write_text(
        f'[server]\ndata = "data"\n[opcua]\nport = {port}\n'
        f'[[bus]]\nname = "dry-end"\nport = "/dev/null"\nworker = "remote"\n{UNITS}'
    )
    return config


def process_of(house: House) -> OpcuaProcess:
    (process,) = house.services[OpcuaProcesses]
    return process


@asynccontextmanager
async def site(folder: Path, port: int) -> AsyncIterator[House]:
    """Run a site that serves OPC UA, with a token for programs and one that is only for a worker."""
    async with complete_app(folder, config=configuration(folder, port)) as house:
        key = Token(0, TOKEN, Role.VIEWER, "test", UnixTime(0.0), None)
        worker = Token(0, "cabinet", Role.WORKER, "test", UnixTime(0.0), None, "dry-end")
        await house.services[Database].write(lambda c: store.add_token(c, secret_hash(SECRET), key))
        await house.services[Database].write(lambda c: store.add_token(c, secret_hash("w"), worker))
        async with responding(await house.worker()):
            yield house


@asynccontextmanager
async def responding(worker: PlayedWorker) -> AsyncIterator[None]:
    """Let the first unit respond all the time, at rest by an emergency stop."""

    async def respond() -> None:
        while True:
            await worker.update(reading(1, commanded=0, inputs=0))
            await asyncio.sleep(0.2)

    task = asyncio.create_task(respond())
    yield
    task.cancel()


async def until_value(client: Client, name: str, expected: object) -> None:
    """Wait until a client reads a value."""
    node = client.get_node(ua.NodeId(name, 1))
    async with asyncio.timeout(60):
        while True:
            found = await node.read_data_value(raise_on_bad_status=False)
            if found.Value is not None and found.Value.Value == expected:
                return
            await asyncio.sleep(0.05)


async def serves(house: House) -> None:
    await until(lambda: process_of(house).status.is_serving, "OPC UA is served")


async def test_a_client_reads_what_units_report_and_a_killed_process_is_started_again(tmp_path: Path) -> None:
    port = free_port()
    client = client_certificate(tmp_path / "client")
    async with site(tmp_path / "site", port) as house:
        server = OpcuaServer(tmp_path / "site" / "data" / "opcua", port=port)
        server.trust(client)
        await serves(house)
        async with connected(server, client, tmp_path / "client") as reader:
            await until_value(reader, "dry-end/1/Speed/Actual", 0.0)
            await until_value(reader, "dry-end/1/Alarms/Names", ["Emergency stop"])
            await until(lambda: process_of(house).status.sessions == 1, "the session is counted")
            page = (await house.http("admin").get("/system")).text
            assert f"serves at 127.0.0.1:{port}; sessions: 1, refused: 0" in page
            metrics = (await house.http("admin").get("/metrics")).text
            assert "lineside_opcua_sessions 1.0" in metrics
            assert "lineside_opcua_restarts_total 0.0" in metrics
        with pytest.raises(ua.UaStatusCodeError):
            async with connected(server, client, tmp_path / "client", user="cabinet", secret="w"):
                pass
        (found,) = await asyncio.to_thread(lambda: list(opcua(load(tmp_path / "site" / "lineside.toml"))))
        assert (found.message.code, found.is_fault) == ("check_opcua", False)
        killed = pid_of_process()
        os.kill(killed, signal.SIGKILL)
        await until(lambda: process_of(house).restarts == 1, "it is started again")
        assert process_of(house).fault is not None
        await until(lambda: pid_of_process() not in (0, killed), "another process runs")


def pid_of_process() -> int:
    """Return the id of the OPC UA process that this test has started; 0 while there is none."""
    for entry in Path(f"/proc/{os.getpid()}/task").iterdir():
        for child in (entry / "children").read_text().split():
            with suppress(OSError):  # it has ended
                if b"app.cli.opcua" in Path(f"/proc/{child}/cmdline").read_bytes():
                    return int(child)
    return 0


async def test_a_port_in_use_and_a_missing_package_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = await asyncio.start_server(lambda *_: None, "127.0.0.1", 0)
    port = taken.sockets[0].getsockname()[1]
    async with site(tmp_path / "site", port) as house:
        process = process_of(house)
        await until(lambda: process.fault is not None, "the fault is known")
        assert process.fault is not None
        assert process.fault.code == "opcua_port"
        assert "Choose another port" in in_english(process.state())
        monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
        await until(
            lambda: process.fault and process.fault.code == "opcua_no_package", "the package is missed"
        )
        alarms = house.services[SiteAlarms]
        await until(lambda: alarms.present(alarms.list.alarms["_.opcua_lost"]) == process.fault, "its alarm")
        page = (await house.http("admin").get("/system")).text
        assert "asyncua is not installed" in page
    taken.close()


async def test_without_a_table_nothing_is_started(tmp_path: Path) -> None:
    async with complete_app(tmp_path) as house:
        assert house.services[OpcuaProcesses] == ()
        assert "lineside_opcua" not in (await house.http("admin").get("/metrics")).text
