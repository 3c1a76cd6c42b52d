"""The feature of the OPC UA server, if one is configured."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.core.database import Database
from app.feature import Feature, Services
from app.line.alarms.line_alarms import LineAlarms, SiteAlarms
from app.line.conditions.catalogue import OPCUA_LOST
from app.line.live.bus_live import LiveState
from app.settings import Settings
from app.system.opcua.settings import FOLDER, OpcuaProcesses, OpcuaSettings
from app.version import VERSION

if TYPE_CHECKING:
    from app.system.opcua.link import Begin


def make(services: Services) -> None:
    wanted = services.settings.opcua
    if wanted is None:
        services.add(OpcuaProcesses())
        return
    from app.system.opcua.process import OpcuaProcess

    alarms = services[LineAlarms]
    process = OpcuaProcess(
        _begin(services.settings, wanted),
        tuple(services[LiveState].buses.values()),
        alarms.unit_alarms,
        services[Database],
    )
    services.add(OpcuaProcesses([process]))
    alarms.subscribe(process.note_alarm)
    services[SiteAlarms].watch("opcua_lost", lambda: OPCUA_LOST.holds(process.fault) and process.fault)
    services.lifespan.add("OPC UA", process.follow, end=process.end)


def _begin(settings: Settings, wanted: OpcuaSettings) -> Begin:
    from app.system.opcua.link import Begin

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
