"""Commands to units: checked, recorded, sent, and read back."""

from __future__ import annotations

from functools import partial

from app.core.database import Database
from app.core.find.finders import Finders
from app.core.web.templating import HeadControl, Templates
from app.feature import Feature, Services
from app.line.commands.api import commands, safeguards, trace
from app.line.commands.catalogue import ROLES_BY_COMMAND
from app.line.commands.finding import ParameterFinder
from app.line.commands.pages import (
    bus,
    control,
    faceplate,
    outputs,
    parameters,
    setpoints,
    speed,
    undo,
    unit,
    zero,
)
from app.line.commands.safeguards import ACTS, Safeguards
from app.line.commands.service.command_service import CommandService
from app.line.commands.service.idempotency import IdempotencyCache
from app.line.commands.service.record import CommandRecord
from app.line.feed.channel import Channel
from app.line.live.bus_live import BusLive, LiveState
from app.line.live.hub import Hub
from app.line.live.sources import Sources
from app.people.audit.log import EventLog
from app.people.auth.accounts import Accounts
from app.people.auth.rights import Rights
from bus.instants import unix_now


def make(services: Services) -> None:
    services[Templates].permit(ROLES_BY_COMMAND)
    services[Finders].add("find_parameters", ParameterFinder(services[LiveState]))
    database, events, rights, hub = services[Database], services[EventLog], services[Rights], services[Hub]
    record, idempotency = CommandRecord(events, database, unix_now), IdempotencyCache()
    for name, of_bus in services.buses.items():
        guards = Safeguards(
            name,
            of_bus[BusLive].units,
            database,
            events,
            control_required=services.settings.site.control,
            find=services[Accounts].find,
            rights=rights,
        )
        guards.on_block(partial(hub.refresh_unit, name))
        guards.on_control(hub.show_control)
        services[Sources].guards[name] = guards
        services.lifespan.add(f"safeguards of {name}", start=of_bus.add(guards).load)
        live, channel = of_bus[BusLive], of_bus[Channel]
        of_bus.add(CommandService(live, channel, record, idempotency, guards, rights))
    all_guards = services.of_buses(Safeguards).values()
    services.add(HeadControl(lambda: [guards.bus_control() for guards in all_guards]))


FEATURE = Feature(
    make,
    (
        commands.router,
        safeguards.router,
        trace.router,
        setpoints.router,
        zero.router,
        speed.router,
        outputs.router,
        parameters.router,
        bus.router,
        control.router,
        undo.router,
        unit.router,
        faceplate.router,
    ),
    ACTS,
)
