"""The OPC UA server, where one is configured."""

from __future__ import annotations

from app.core.database import Database
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms
from app.line.live.bus_live import LiveState
from app.settings import Settings
from app.system.configuration.service import SystemsBeside
from app.system.opcua.link import Begin
from app.system.opcua.process import OpcuaProcess, OpcuaProcesses
from app.system.opcua.settings import FOLDER
from app.version import VERSION


def make(services: Services) -> None:
    if services.settings.opcua is None:
        services.add(OpcuaProcesses())
        return
    alarms = services[LineAlarms]
    process = OpcuaProcess(
        _begin(services.settings),
        tuple(services[LiveState].buses.values()),
        alarms.count_active,
        services[Database],
    )
    services.add(OpcuaProcesses([process]))
    alarms.subscribe(process.note_alarm)
    services.lifespan.add("OPC UA", process.follow, end=process.end)
    services[SystemsBeside].append(process.state)


def _begin(settings: Settings) -> Begin:
    wanted = settings.opcua
    assert wanted is not None
    return Begin(
        settings.site.name,
        VERSION,
        *settings.opcua_address,
        str(settings.server.data / FOLDER),
        list(wanted.names),
        wanted.manufacturer,
        wanted.serial_number,
        [bus.model_dump_json() for bus in settings.bus],
    )


FEATURE = Feature(make)
