"""The OPC UA process: it follows the live state over a pipe and serves it until the pipe ends."""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import sys
from collections.abc import AsyncIterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import structlog
from asyncua import Server, ua

from app.errors import system_error
from app.line.live.bus_live import BusLive, LiveState, changed_by, unit_link_now
from app.system.opcua.access import TokenList, TrustList, ends_at, own_certificate
from app.system.opcua.gate import Gate, ViewerServer
from app.system.opcua.link import (
    Begin,
    Changes,
    Frames,
    Keys,
    StandingAlarm,
    Status,
    UnitAlarms,
    frame,
    to_process,
)
from app.system.opcua.space import LineNodes
from bus.contract import Reading
from bus.errors import LinesideError
from bus.instants import UnixTime, monotonic_now, unix_now
from bus.messages import Message
from bus.settings import BusSettings

TICK_S = 0.5
"""The seconds between checks of ages if nothing is reported."""
STATUS_S = 1.0
READ_BYTES = 262_144
DICTIONARIES = tuple(map(ua.NodeId, (ua.ObjectIds.OpcUa_BinarySchema, ua.ObjectIds.OpcUa_XmlSchema)))
"""Each client has these descriptions of the standard types, which are 200 and 340 kB: read or monitored a
thousand times at once they would fill the memory."""
log = structlog.get_logger()


class Follower:
    """The live state in the OPC UA process, and the units that changed since their nodes were written."""

    def __init__(self, live: LiveState) -> None:
        self.live = live
        self.tokens = TokenList()
        self.reported = asyncio.Event()
        self.alarms: dict[tuple[str, int], list[StandingAlarm]] = {}
        self._readings: set[tuple[str, int]] = set()
        self._others: set[tuple[str, int]] = set()
        self._links: dict[tuple[str, int], str] = {}

    def take(self, message: Changes | UnitAlarms | Keys) -> None:
        """Apply a message of the server."""
        match message:
            case Changes():
                self._apply(self.live.buses[message.bus], message)
            case UnitAlarms():
                alarms = {(message.bus, unit): standing for unit, standing in message.of_units.items()}
                self._others |= alarms.keys()
                self.alarms |= alarms
            case Keys():
                self.tokens.set(message.keys)

    def _apply(self, bus: BusLive, message: Changes) -> None:
        bus.apply(message.updates)
        name = message.bus
        readings = [update for update in message.updates if isinstance(update, Reading)]
        others = [update for update in message.updates if not isinstance(update, Reading)]
        self._readings |= {(name, each.unit) for each in readings if each.unit in bus.units}
        self._others |= {(name, unit) for unit in changed_by(bus, others)[0]}

    def judge_ages(self) -> None:
        """Note the units whose link state has changed as time passed."""
        now = unix_now()
        for name, bus in self.live.buses.items():
            for number, unit in bus.units.items():
                link = unit_link_now(bus, unit, now)
                if self._links.get((name, number)) != link:
                    self._links[name, number] = link
                    self._others.add((name, number))

    def changed(self) -> list[tuple[tuple[str, int], bool]]:
        """Return the units whose nodes must be written, and whether more than the reading has changed."""
        found = [(place, place in self._others) for place in sorted(self._readings | self._others)]
        self._readings.clear()
        self._others.clear()
        return found


async def serve(source: AsyncIterator[object], report: StatusPipe) -> None:
    """Serve OPC UA clients with the data of the messages of ``source`` until it ends. Raise LinesideError if
    that is not possible."""
    begin = await anext(source)
    assert isinstance(begin, Begin)
    buses = [BusSettings.model_validate_json(each) for each in begin.buses]
    follower = Follower(LiveState(buses, unix_now()))
    folder = Path(begin.folder)
    own = own_certificate(folder, begin.names, begin.site, datetime.now(UTC))
    trust = TrustList(folder)
    server = ViewerServer(own, trust, follower.tokens)
    report.certificate_ends = ends_at(own.certificate)
    working = [asyncio.create_task(_follow(source, follower)), asyncio.create_task(report.run())]
    gate = Gate(server)
    try:
        try:
            listening = await gate.bind(begin.host, begin.port)
        except OSError as error:
            place = f"{begin.host}:{begin.port}"
            raise LinesideError(Message.of("opcua_port", place=place, reason=system_error(error))) from None
        nodes = await _built(begin, server, own.uri, follower)
        await listening.start_serving()
        report.gate = gate
        working += [asyncio.create_task(_write(follower, nodes)), asyncio.create_task(gate.sweep())]
        log.info("OPC UA server listens", host=begin.host, port=begin.port)
        done, _ = await asyncio.wait(working, return_when=asyncio.FIRST_COMPLETED)
        listening.close()
        gate.close()
        for task in done:
            task.result()
    finally:
        for task in working:
            task.cancel()
        await asyncio.gather(*working, return_exceptions=True)


async def _built(begin: Begin, server: ViewerServer, uri: str, follower: Follower) -> LineNodes:
    # The gate counts what asyncua logs of requests and their faults.
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    made = Server(iserver=server)
    await made.init()
    await made.set_application_uri(uri)
    name = f"Lineside {begin.site}"
    await made.set_build_info("urn:lineside", "Lineside", name, begin.version, "", datetime.now(UTC))
    server.add_own_endpoint(uri, name, f"opc.tcp://{begin.host}:{begin.port}/")
    for dictionary in DICTIONARIES:
        await made.write_attribute_value(dictionary, ua.DataValue(ua.Variant(b"")))
    nodes = LineNodes(made, begin.manufacturer, begin.serial_number)
    await nodes.build(list(follower.live.buses.values()))
    await server.start()
    return nodes


async def _follow(source: AsyncIterator[object], follower: Follower) -> None:
    async for message in source:
        assert isinstance(message, Changes | UnitAlarms | Keys)
        follower.take(message)
        follower.reported.set()


async def _write(follower: Follower, nodes: LineNodes) -> None:
    """Write the nodes of new data as soon as the server reports it, and check ages every `TICK_S`."""
    judge_at = monotonic_now()
    while True:
        now = unix_now()
        if monotonic_now() >= judge_at:
            judge_at = monotonic_now() + TICK_S
            follower.judge_ages()
        for place, others in follower.changed():
            await nodes.write(place, follower.alarms.get(place, []), now, others=others)
        with suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, judge_at - monotonic_now())):
                await follower.reported.wait()
        follower.reported.clear()


class StatusPipe:
    """The writer of the process's status to the server, once a second. ``gate``: set once clients are
    served."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self.gate: Gate | None = None
        self.certificate_ends: UnixTime | None = None

    async def run(self) -> None:
        """Report until canceled. Raise OSError once nobody listens."""
        while True:
            self.write(self._status())
            await asyncio.sleep(STATUS_S)

    def _status(self) -> Status:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        memory = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()
        cpu_s = usage.ru_utime + usage.ru_stime
        gate, ends = self.gate, self.certificate_ends
        if gate is None:
            return Status(cpu_s=cpu_s, memory_bytes=memory, certificate_ends=ends)
        server = gate.server
        sessions = [each.session for each in gate.connections if each.session is not None]
        return Status(
            True,
            len(sessions),
            len(server.subscription_service.subscriptions),
            server.refusals.total,
            server.trust.waiting(),
            cpu_s,
            memory,
            ends,
            sorted({each.key.id for each in sessions if each.key is not None}),
        )

    def write(self, status: Status) -> None:
        """Write a status. Raise OSError."""
        os.write(self._descriptor, frame(status))


async def _messages() -> AsyncIterator[object]:
    """Yield the messages of the server from standard input."""
    loop, reader = asyncio.get_running_loop(), asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    frames = Frames(to_process)
    while data := await reader.read(READ_BYTES):
        for message in frames.feed(data):
            yield message


async def _run(report: StatusPipe) -> None:
    await serve(_messages(), report)


def run() -> int:
    """Serve until standard input ends; return the exit code. Only the status goes to standard output: the
    output of libraries goes to the log."""
    report = StatusPipe(os.dup(sys.stdout.fileno()))
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        asyncio.run(_run(report))
    except LinesideError as error:
        with suppress(OSError):
            report.write(Status(fault=error.message))
        return 1
    except OSError as error:
        log.error("OPC UA process ended", why=system_error(error))
        return 1
    return 0
