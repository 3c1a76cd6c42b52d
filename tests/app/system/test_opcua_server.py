"""The OPC UA process as clients see it, of asyncua and of other makers: the nodes of the lines, who may
connect, and what is bounded."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import socket
import struct
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio
from asyncua import Client, ua
from asyncua.ua.uaerrors import BadIdentityTokenRejected, BadUserAccessDenied, UaStatusCodeError

from app.cli.status import is_opcua_server
from app.system.opcua import gate
from app.system.opcua.access import OwnCertificate
from app.system.opcua.link import StandingAlarm
from bus.instants import unix_now
from tests.app.fake_worker import until
from tests.app.opcua import (
    SECRET,
    TOKEN,
    OpcuaServer,
    client_certificate,
    connected,
    responds,
    scales,
    secured,
)
from tests.for_each import for_each

SOURCES = Path(__file__).parents[1]
PARTS = {"Identification", "Speed", "Inputs", "Outputs", "Link", "Alarms", "Parameters"}
GOPCUA = "v0.8.0"
NODE_OPCUA = ("node-opcua-client@2.182.2", "node-opcua-certificate-manager@2.182.1")
pytestmark = pytest.mark.asyncio(loop_scope="module")
OWN = 1
ACTUAL = ua.NodeId("dry-end/1/Speed/Actual", OWN)


@dataclass
class Site:
    """An OPC UA process and a client that it trusts. ``folder``: of the certificate of the client."""

    server: OpcuaServer
    client: OwnCertificate
    folder: Path

    def connected(self, **options: str) -> Any:
        return connected(self.server, self.client, self.folder, **options)

    async def secured(self) -> Client:
        return await secured(self.server, self.client, self.folder)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def site(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Site]:
    folder = tmp_path_factory.mktemp("opcua")
    made = Site(OpcuaServer(folder / "server"), client_certificate(folder / "client"), folder / "client")
    made.server.trust(made.client)
    async with made.server.running():
        yield made


@pytest_asyncio.fixture(autouse=True, loop_scope="module")
async def _begins_as_ever(site: Site) -> None:
    site.server.tokens(TOKEN)
    await site.server.until(lambda status: status.sessions == 0)


async def value(client: Client, name: str) -> ua.DataValue:
    return await client.get_node(ua.NodeId(name, OWN)).read_data_value(raise_on_bad_status=False)


async def until_value(client: Client, name: str, expected: object) -> ua.DataValue:
    async with asyncio.timeout(60):
        while True:
            found = await value(client, name)
            if found.Value is not None and found.Value.Value == expected:
                return found
            await asyncio.sleep(0.05)


# --- nodes and values ---


async def test_a_line_is_a_machine_with_its_units_as_components(site: Site) -> None:
    async with site.connected() as client:
        devices = await client.get_namespace_index("http://opcfoundation.org/UA/DI/")
        machinery = await client.get_namespace_index("http://opcfoundation.org/UA/Machinery/")
        path = [f"{machinery}:Machines", f"{OWN}:dry-end", f"{devices}:Identification"]
        identification = await client.nodes.objects.get_child(path)
        assert (await identification.read_type_definition()) == ua.NodeId(1012, machinery)
        about = {
            name: await (await identification.get_child(f"{devices}:{name}")).read_value()
            for name in ("Manufacturer", "SerialNumber", "ProductInstanceUri")
        }
        assert about["Manufacturer"].Text == "Maker"
        assert about["SerialNumber"] == "4711"
        assert about["ProductInstanceUri"].endswith(":dry-end")
        components = await client.nodes.objects.get_child([*path[:2], f"{machinery}:Components"])
        names = [(await each.read_browse_name()).Name for each in await components.get_children()]
        assert names == ["Unwind", "Rewind", "Spare"]
        unit = await components.get_child(f"{OWN}:Unwind")
        children = {(await each.read_browse_name()).Name for each in await unit.get_children()}
        assert children >= PARTS | {"Analog"}
        assert "Brake" in [
            (await each.read_browse_name()).Name
            for each in await (await unit.get_child(f"{OWN}:Outputs")).get_children()
        ]


async def test_a_value_has_its_unit_its_range_and_the_time_of_its_reading(site: Site) -> None:
    at = unix_now()
    site.server.report(*scales(1, at), *responds(1, at, actual=777))
    async with site.connected() as client:
        found = await until_value(client, "dry-end/1/Speed/Actual", 77.7)
        assert found.StatusCode.is_good()
        assert found.SourceTimestamp.timestamp() == pytest.approx(at, abs=1e-3)
        unit = (await value(client, "dry-end/1/Speed/Actual/EngineeringUnits")).Value.Value
        assert (unit.DisplayName.Text, unit.UnitId) == ("m/min", 12888)
        span = (await value(client, "dry-end/1/Speed/Actual/EURange")).Value.Value
        assert (span.Low, span.High) == (0.0, 2000.0)


async def test_the_alarms_of_a_unit_are_lists(site: Site) -> None:
    at = unix_now()
    stop = StandingAlarm("E-stop active", "urgent", True, False, at)
    cleared = StandingAlarm("Not at speed", "high", False, False, at)
    async with site.connected() as client:
        for alarms in ([stop, cleared], []):
            site.server.alarms({1: alarms})
            await until_value(client, "dry-end/1/Alarms/Names", [alarm.name for alarm in alarms])
            found = {
                name: (await value(client, f"dry-end/1/Alarms/{name}")).Value.Value
                for name in ("Priorities", "IsActive", "Acknowledged", "Since", "Active")
            }
            assert found.pop("Active") == len(alarms[:1]), "what has cleared is not counted"
            since = found.pop("Since")
            assert [each.timestamp() for each in since] == pytest.approx([float(at)] * len(alarms), abs=1e-3)
            assert [*zip(*found.values(), strict=True)] == [
                (alarm.priority, alarm.is_active, alarm.is_acknowledged) for alarm in alarms
            ]


async def test_the_quality_of_a_value_follows_its_age(site: Site) -> None:
    async with site.connected() as client:
        at = unix_now()
        site.server.report(*scales(2, at), *responds(2, at, actual=500))
        await until_value(client, "dry-end/2/Speed/Actual", 50.0)
        await until_value(client, "dry-end/2/Link/State", "stale")
        old = await value(client, "dry-end/2/Speed/Actual")
        assert (old.Value.Value, old.StatusCode.name) == (50.0, "UncertainLastUsableValue")
        site.server.report(*responds(2, at - 30, actual=500))
        await until_value(client, "dry-end/2/Link/State", "offline")
        gone = await value(client, "dry-end/2/Speed/Actual")
        assert (gone.Value.Value, gone.StatusCode.name) == (None, "BadNoCommunication")


class Changes:
    """Subscriber that keeps the values of a subscription."""

    def __init__(self) -> None:
        self.values: list[object] = []

    def datachange_notification(self, _node: object, val: object, _data: object) -> None:
        self.values.append(val)


async def test_a_subscription_gets_what_changes_and_no_faster_than_allowed(site: Site) -> None:
    async with site.connected() as client:
        changes = Changes()
        subscription = await client.create_subscription(1, changes)
        await subscription.subscribe_data_change(client.get_node(ACTUAL))
        for actual in (100, 200, 300):
            site.server.report(*scales(1, unix_now()), *responds(1, unix_now(), actual=actual))
            await until(partial(changes.values.__contains__, actual / 10), "the value")
        assert changes.values[-3:] == [10.0, 20.0, 30.0]
        params = ua.CreateSubscriptionParameters()
        params.RequestedPublishingInterval = 0.0
        params.RequestedLifetimeCount, params.RequestedMaxKeepAliveCount = 10**9, 10**9
        made = await client.uaclient.create_subscription(params, None)
        assert made.RevisedPublishingInterval == gate.MIN_PUBLISHING_MS
        assert made.RevisedLifetimeCount == gate.MAX_LIFETIME


# --- who may connect ---


async def test_a_client_that_is_not_trusted_is_refused_and_waits_to_be_trusted(
    site: Site, tmp_path: Path
) -> None:
    other = client_certificate(tmp_path, "Stranger")
    with pytest.raises((ConnectionError, UaStatusCodeError, TimeoutError)):
        async with connected(site.server, other, tmp_path):
            pass
    rejected = [path for path in (site.server.folder / "rejected").iterdir() if "Stranger" in path.name]
    assert len(rejected) == 1
    moved = rejected[0].rename(site.server.folder / "trusted" / rejected[0].name)
    async with connected(site.server, other, tmp_path) as client:
        await value(client, "dry-end/1/Link/State")
        await site.server.until(lambda status: status.accounts == [7])
        moved.unlink()
        await site.server.until(lambda status: status.sessions == 0)


async def test_nobody_is_anonymous(site: Site) -> None:
    client = await site.secured()
    with pytest.raises(BadIdentityTokenRejected):
        await client.connect()


@for_each(("user", "secret"), [(TOKEN, "wrong"), ("nobody", "x"), (TOKEN, "x" * 100)])
async def test_a_wrong_token_is_refused(site: Site, user: str, secret: str) -> None:
    with pytest.raises((BadUserAccessDenied, UaStatusCodeError, ConnectionError)):
        async with site.connected(user=user, secret=secret):
            pass


async def test_a_revoked_token_ends_its_sessions(site: Site) -> None:
    async with site.connected() as client:
        await value(client, "dry-end/1/Link/State")
        site.server.tokens("another")
        await site.server.until(lambda status: status.sessions == 0)


async def test_without_security_only_the_endpoint_is_told(site: Site) -> None:
    plain = Client(site.server.url, timeout=60)
    (endpoint,) = await plain.connect_and_get_server_endpoints()
    assert endpoint.SecurityPolicyUri.endswith("#Basic256Sha256")
    assert endpoint.SecurityMode == ua.MessageSecurityMode.SignAndEncrypt
    assert [each.TokenType for each in endpoint.UserIdentityTokens] == [ua.UserTokenType.UserName]
    plain.set_user(TOKEN)
    with pytest.raises(UaStatusCodeError):
        await plain.connect()


async def test_a_session_is_not_taken_over_by_its_number(site: Site) -> None:
    """A session cannot be used from another connection, though asyncua numbers sessions so that their tokens
    can be guessed."""
    async with site.connected(), AsyncExitStack() as stack:
        thief = Client(site.server.url, timeout=60)
        await thief.connect_sessionless()
        stack.push_async_callback(thief.disconnect_sessionless)
        read = ua.ReadRequest()
        read.Parameters.NodesToRead = [ua.ReadValueId(ACTUAL, ua.AttributeIds.Value)]
        for number in range(1000, 1040):
            activate = ua.ActivateSessionRequest()
            activate.RequestHeader.AuthenticationToken = ua.NodeId(number)
            read.RequestHeader.AuthenticationToken = ua.NodeId(number)
            for request in (activate, read):
                with pytest.raises(UaStatusCodeError):
                    await thief.uaclient.protocol.send_request(request)


# --- nothing is changed ---


async def test_nothing_is_written_or_called_or_made(site: Site) -> None:
    async with site.connected() as client:
        results = await client.uaclient.write(_write(ACTUAL, 1.0))
        assert [each.name for each in results] == ["BadNotWritable"]
        with pytest.raises(BadUserAccessDenied):
            await client.nodes.server.call_method(ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems), 1)
        with pytest.raises(BadUserAccessDenied):
            await client.nodes.objects.add_object(OWN, "mine")
        with pytest.raises(BadUserAccessDenied):
            await client.get_node(ACTUAL).read_raw_history()


def _write(node: ua.NodeId, number: float) -> ua.WriteParameters:
    params = ua.WriteParameters()
    wanted = ua.WriteValue()
    wanted.NodeId, wanted.AttributeId = node, ua.AttributeIds.Value
    wanted.Value = ua.DataValue(ua.Variant(number))
    params.NodesToWrite = [wanted]
    return params


# --- bounds ---


async def test_requests_are_bounded(site: Site) -> None:
    async with site.connected() as client:
        read = ua.ReadParameters()
        read.NodesToRead = [ua.ReadValueId(ACTUAL, ua.AttributeIds.Value)] * (gate.MAX_READS + 1)
        with pytest.raises(UaStatusCodeError, match="BadTooManyOperations"):
            await client.uaclient.read(read)
        browse = ua.BrowseParameters()
        browse.NodesToBrowse = [ua.BrowseDescription()] * (gate.MAX_BROWSES + 1)
        with pytest.raises(UaStatusCodeError, match="BadTooManyOperations"):
            await client.uaclient.browse(browse)
        for _ in range(gate.MAX_SUBSCRIPTIONS_OF_SESSION):
            subscription = await client.create_subscription(1000, Changes())
        with pytest.raises(UaStatusCodeError, match="BadTooManySubscriptions"):
            await client.create_subscription(1000, Changes())
        handles = await subscription.subscribe_data_change([client.get_node(ACTUAL)] * 3, queuesize=10**6)
        assert len(handles) == 3


async def test_a_subscription_of_another_session_is_unknown(site: Site) -> None:
    async with site.connected() as one, site.connected() as other:
        subscription = await one.create_subscription(1000, Changes())
        results = await other.uaclient.delete_subscriptions([subscription.subscription_id])
        assert [each.name for each in results] == ["BadSubscriptionIdInvalid"]
        await subscription.subscribe_data_change(one.get_node(ACTUAL))


async def raw(site: Site, data: bytes) -> bytes:
    """Send bytes, and return what comes until the server ends the connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", site.server.port)
    writer.write(data)
    try:
        async with asyncio.timeout(30):
            return await reader.read(-1)
    except ConnectionError:
        return b""
    finally:
        writer.close()


@for_each(
    "data",
    [
        b"GET / HTTP/1.1\r\nHost: plant\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + b"\x00" * 64,
        b"MSGF" + struct.pack("<I", 0xFFFFFFFF) + b"\x00" * 64,
        b"HELF" + struct.pack("<I", 3) + b"\x00" * 64,
        b"OPNF" + struct.pack("<I", 70_000),
    ],
)
async def test_what_is_no_message_ends_its_connection_at_once(site: Site, data: bytes) -> None:
    response = await raw(site, data)
    assert response.startswith(b"ERRF")
    assert await is_opcua_server("127.0.0.1", site.server.port)


@pytest.mark.soak
async def test_a_connection_without_a_session_ends(site: Site) -> None:
    """A connection ends that says nothing, or stops within a message, twelve seconds later; in
    `test_opcua_gate` soon."""
    nothing, half = await asyncio.gather(raw(site, b""), raw(site, b"HELF" + struct.pack("<I", 40) + b"\x00"))
    assert (nothing, half) == (b"", b"")


async def test_connections_of_an_address_are_bounded(site: Site) -> None:
    async with AsyncExitStack() as stack:
        for _ in range(gate.MAX_CONNECTIONS_OF_ADDRESS):
            _, writer = await asyncio.open_connection("127.0.0.1", site.server.port)
            stack.callback(writer.close)
        assert await raw(site, b"HELF") == b""
    await site.server.until(lambda status: status.sessions == 0)


# --- clients that take without end ---


async def reads_on(site: Site) -> None:
    """Assert that a new client reads what is reported now."""
    actual = 100 + int(float(unix_now())) % 1000
    site.server.report(*scales(1, unix_now()), *responds(1, unix_now(), actual=actual))
    async with site.connected() as client:
        await until_value(client, "dry-end/1/Speed/Actual", actual / 10)


@pytest.mark.soak
async def test_a_client_that_does_not_read_is_given_up(site: Site) -> None:
    """On a busy machine, whose server must encode megabytes, this takes a minute: `test_opcua_gate` gives up
    such a client on a real socket."""
    refused, memory = site.server.status.refused, site.server.status.memory_bytes
    async with site.connected() as client:
        browse = ua.BrowseRequest()
        widest = ua.BrowseDescription(NodeId=ua.NodeId(ua.ObjectIds.Structure))
        browse.Parameters.NodesToBrowse = [widest] * 18
        transport = client.uaclient.protocol.transport
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        transport.pause_reading()
        send = client.uaclient.protocol.send_request
        asked = [asyncio.create_task(send(browse, timeout=100)) for _ in range(gate.MAX_PENDING)]
        await site.server.until(lambda status: status.refused > refused and status.sessions == 0)
        for task in asked:
            task.cancel()
        await asyncio.gather(*asked, return_exceptions=True)
    assert site.server.status.memory_bytes - memory < 30_000_000
    await reads_on(site)


async def abandon(site: Site, times: int) -> None:
    """Begin sessions with a subscription, and drop their connections without a word."""
    for _ in range(times):
        client = await site.secured()
        client.set_user(TOKEN)
        client.set_password(SECRET)
        await client.connect()
        subscription = await client.create_subscription(1000, Changes())
        await subscription.subscribe_data_change(client.get_node(ACTUAL))
        client.uaclient.protocol.transport.abort()
        with suppress(ConnectionError, TimeoutError, ua.UaError):
            await client.disconnect()


async def test_nothing_is_left_of_an_abandoned_session(site: Site) -> None:
    await abandon(site, 5)
    await site.server.until(lambda status: status.sessions == status.subscriptions == 0)


@pytest.mark.soak
async def test_memory_is_flat_over_abandoned_sessions(site: Site) -> None:
    await abandon(site, 100)
    memory = site.server.status.memory_bytes
    await abandon(site, 1000)
    await site.server.until(lambda status: status.sessions == status.subscriptions == 0)
    assert site.server.status.memory_bytes - memory < 5_000_000


# --- clients of other makers ---


async def look(site: Site, *program: str, secret: str = SECRET) -> dict[str, Any]:
    """Run a client to its end; return what it found."""
    words = (*program, site.server.url, str(site.folder), TOKEN, secret, site.client.uri)
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    text, _ = await process.communicate()
    found: dict[str, Any] = json.loads(text.splitlines()[-1])
    return found


@asynccontextmanager
async def responding(server: OpcuaServer) -> AsyncIterator[None]:
    """Let the first unit respond all the time."""

    async def respond() -> None:
        server.report(*scales(1, unix_now()))
        while True:
            server.report(*responds(1, unix_now()))
            await asyncio.sleep(0.25)

    task = asyncio.create_task(respond())
    yield
    task.cancel()


@pytest.mark.soak
async def test_node_opcua_reads_the_line(site: Site, tmp_path: Path) -> None:
    """node-opcua reads the line; its 125 packages, three quarters of those of Node, are fetched for it."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        pytest.skip("Node.js is not installed")
    shutil.copy(SOURCES / "opcua_client.mjs", tmp_path)
    await _run_or_skip(npm, "install", "--ignore-scripts", "--no-audit", *NODE_OPCUA, cwd=tmp_path)
    began = float(unix_now())
    async with responding(site.server):
        found = await look(site, node, str(tmp_path / "opcua_client.mjs"))
    assert "error" not in found, found
    assert found["actual"] == [123.4, "Good", "Double"]
    assert datetime.fromisoformat(found["at"]).timestamp() > began - 60
    assert found["unit"] == ["m/min", 12888]
    assert found["unread"] == "BadWaitingForInitialData"
    assert found["serial"] == "4711"
    assert set(found["parts"]) >= PARTS
    assert found["subscribed"] == 123.4
    assert found["write"] == "BadNotWritable"


@pytest.mark.soak
async def test_gopcua_reads_the_line(site: Site, tmp_path: Path) -> None:
    """gopcua reads the line; its module is fetched and built, which takes a minute."""
    go = shutil.which("go") or shutil.which("go", path="/usr/local/go/bin")
    if go is None:
        pytest.skip("Go is not installed")
    program = await _built(go, tmp_path / "go")
    async with responding(site.server):
        found = await look(site, str(program))
    assert "error" not in found, found
    assert found["actual"] == [123.4, 0]
    assert "BadWaitingForInitialData" in found["unread"]
    assert set(found["parts"]) >= PARTS
    assert found["subscribed"] == 123.4
    assert "BadNotWritable" in found["write"]
    assert "error" in await look(site, str(program), secret="wrong")


async def _built(go: str, folder: Path) -> Path:
    _write_module(folder)
    await _run_or_skip(
        go, "build", "-o", "client", ".", cwd=folder, env={**os.environ, "GOFLAGS": "-mod=mod"}
    )
    return folder / "client"


async def _run_or_skip(*words: str, **options: Any) -> None:
    """Fetch or build a client; skip the test where that cannot be."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*words, stdout=pipe, stderr=pipe, **options)
    _, complaint = await process.communicate()
    if process.returncode:
        pytest.skip(f"no client by {words[0]}: {complaint.decode(errors='replace')[-300:]}")


def _write_module(folder: Path) -> None:
    folder.mkdir()
    shutil.copy(SOURCES / "opcua_client.go", folder / "main.go")
    (folder / "go.mod").write_text(f"module client\n\ngo 1.23\n\nrequire github.com/gopcua/opcua {GOPCUA}\n")
