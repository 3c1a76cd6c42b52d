"""The feature of the page *System*."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from fastapi import APIRouter
from starlette.requests import Request
from starlette.responses import Response

from app.core.database.files import free_bytes
from app.core.server.tls import Encryption
from app.core.web.access import Viewer
from app.core.web.routes import SEARCH, GuardedRoute
from app.core.web.templating import render
from app.errors import Problem
from app.feature import Feature, Services
from app.line.alarms.alarm import Alarm
from app.line.alarms.line_alarms import SiteAlarms
from app.line.history.status import MAX_DAYS
from app.people.audit.anchor import EVERY_S, Anchoring
from app.people.auth.single_sign_on import SingleSignOn
from app.system.backup.service import Backups
from app.system.configuration.service import ConfigurationFile
from app.system.mqtt.session import Nodes
from app.system.opcua.settings import OpcuaProcesses
from app.system.peers.board import LineTiles
from app.system.postgresql.publisher import Publisher
from app.system.state.disk import forecast, store_sizes
from bus.instants import Monotonic, UnixTime, monotonic_now, unix_now
from bus.messages import Message, number

GB = 1e9


@dataclass(frozen=True, slots=True)
class SystemRow:
    """A row about one safeguard of the records. ``level``: the priority of its alarm, empty while all is
    well; ``next``: its next time, in words if it runs all the time; ``help``: the chapter about it;
    ``alarm``: the id of the alarm about a fault; ``is_faulty``: whether a connection has a fault, which has a
    mark until the alarm has come."""

    name: Message | str
    state: Message
    last: UnixTime | None = None
    next: UnixTime | Message | None = None
    to_do: Message | None = None
    help: str = ""
    level: str = ""
    alarm: str = ""
    is_faulty: bool = False


async def system_rows(services: Services, now: UnixTime, monotonic: Monotonic) -> list[SystemRow]:
    """Return the rows of the page, in order."""
    rows = [
        _alarmed(services, _backups(services, now), "backup_overdue"),
        _alarmed(services, _audit_log(services), "audit_degraded", "events_not_archived"),
        _alarmed(services, await _disk(services, now), "history_degraded", "disk_low"),
        _alarmed(services, _plant_database(services, now), "publisher_day_behind", "publisher_behind"),
        _alarmed(services, _certificate(services), "certificate_expiring"),
        *await _configuration(services),
        *_company_accounts(services),
        *_marked(services, _nodes(services, now), "broker_lost"),
        *_marked(services, _opcua(services, now), "opcua_lost"),
        *_peers(services, now, monotonic),
    ]
    shown = {row.alarm for row in rows}
    others = (alarm for alarm in _active(services) if alarm.id not in shown)
    return [
        *rows,
        *(
            _row_of(services, alarm, SystemRow(alarm.definition.name, alarm.state_text, alarm.facts.came))
            for alarm in others
        ),
    ]


def _active(services: Services) -> Iterable[Alarm]:
    return [alarm for alarm in services[SiteAlarms].list.alarms.values() if alarm.facts.active]


def _alarmed(services: Services, row: SystemRow, *codes: str) -> SystemRow:
    """Return the row with the first of its alarms that is active: its subject and its response."""
    of_row = [alarm for code in codes for alarm in _active(services) if alarm.definition.code == code]
    return _row_of(services, of_row[0], row) if of_row else row


def _row_of(services: Services, alarm: Alarm, row: SystemRow) -> SystemRow:
    definition = alarm.definition
    name = definition.name
    shown = name if isinstance(name, Message) and name != row.name else row.state
    about = services[SiteAlarms].present(alarm) or shown
    return SystemRow(
        row.name,
        about,
        row.last,
        row.next,
        definition.record.response,
        row.help,
        definition.priority,
        alarm.id,
    )


def _marked(services: Services, rows: Iterable[SystemRow], code: str) -> Iterator[SystemRow]:
    """Yield the rows, the faulty ones with the priority and link of the alarm ``code`` if it is active."""
    alarms = [alarm for alarm in _active(services) if alarm.definition.code == code]
    for row in rows:
        if alarms and row.is_faulty:
            row = replace(row, level=alarms[0].definition.priority, alarm=alarms[0].id)
        yield row


def _backups(services: Services, now: UnixTime) -> SystemRow:
    backups, name, chapter = services[Backups], Message("system_backups"), "backup"
    if services.settings.backup.folder is None:
        to_do = Message("system_set_backup")
        return SystemRow(name, Message("system_not_set_up"), to_do=to_do, help=chapter)
    state = Message("system_backup_is_written" if backups.written else "system_backup_is_due")
    due = max(now, backups.next_due(now))
    return SystemRow(name, backups.failing or state, backups.written, due, help=chapter)


def _audit_log(services: Services) -> SystemRow:
    anchoring = services[Anchoring]
    at = anchoring.compared_at
    following = None if at is None else at + EVERY_S
    return SystemRow(
        Message("system_audit"), Message("system_audit_is_anchored"), at, following, help="audit"
    )


async def _disk(services: Services, now: UnixTime) -> SystemRow:
    settings, data = services.settings, services.settings.server.data
    free = free_bytes(data)
    days = await asyncio.to_thread(lambda: forecast(settings, store_sizes(data), free, now))
    free_gb = number(f"{free / GB:.1f}")
    if days is None:
        state = Message.of("system_disk_unknown", free=free_gb)
    elif days >= MAX_DAYS:
        state = Message.of("system_disk_long", free=free_gb)
    else:
        state = Message.of("system_disk", free=free_gb, n=int(days))
    return SystemRow(Message("system_disk_name"), state, now, Message("system_always"), help="scale")


def _plant_database(services: Services, now: UnixTime) -> SystemRow:
    name, chapter = Message("system_plant_database"), "plant-database"
    if services.settings.postgresql is None:
        return SystemRow(
            name, Message("system_not_set_up"), to_do=Message("system_set_database"), help=chapter
        )
    status = services[Publisher].status
    check = Message("system_check_database") if status.fault else None
    return _link(name, status.state(now), status.last, status.fault, check, chapter)


def _company_accounts(services: Services) -> Iterator[SystemRow]:
    sign_on = services[SingleSignOn]
    if sign_on.settings is not None:
        state = sign_on.fault or Message("system_provider_responds")
        check = Message("system_check_provider") if sign_on.fault else None
        name = Message("system_company_accounts")
        yield _link(name, state, None, sign_on.fault, check, "company-accounts")


async def _configuration(services: Services) -> Iterable[SystemRow]:
    try:
        if not await services[ConfigurationFile].is_waiting():
            return []
    except Problem:
        return []  # The server was started without a file, or its page says why it cannot be read.
    state, to_do = Message("system_configuration_waits"), Message("system_restart")
    return [
        SystemRow(Message("system_configuration"), state, to_do=to_do, help="configuration", is_faulty=True)
    ]


def _link(
    name: Message,
    state: Message,
    last: UnixTime | None,
    fault: Message | None,
    to_do: Message | None,
    chapter: str,
) -> SystemRow:
    """Return the row of a connection, which after a fault tries again by itself."""
    following = Message("system_retries" if fault else "system_always")
    return SystemRow(name, state, last, following, to_do, chapter, is_faulty=fault is not None)


def _nodes(services: Services, now: UnixTime) -> Iterator[SystemRow]:
    if not services[Nodes]:
        to_do = Message("system_set_broker")
        yield SystemRow(Message("system_no_broker"), Message("system_not_set_up"), to_do=to_do, help="mqtt")
    check = Message("system_check_broker")
    for node in services[Nodes]:
        name, fault = Message.of("system_broker", node=node.node.name), node.status.fault
        last = now - node.lag_s() if node.has_delivered else None
        yield _link(name, node.state(), last, fault, check if fault else None, "mqtt")
    overview = services[Nodes].overview
    if overview is not None:
        name, fault = Message("system_broker_lines"), overview.fault
        yield _link(name, overview.state(), None, fault, check if fault else None, "mqtt")


def _opcua(services: Services, now: UnixTime) -> Iterator[SystemRow]:
    name = Message("system_opcua")
    if not services[OpcuaProcesses]:
        to_do = Message("system_set_opcua")
        yield SystemRow(name, Message("system_not_set_up"), to_do=to_do, help="opcua")
    for process in services[OpcuaProcesses]:
        last = now if process.status.is_serving else None
        yield _link(name, process.state(), last, process.fault, process.to_do, "opcua")


def _certificate(services: Services) -> SystemRow:
    encryption, name, chapter = services[Encryption], Message("system_certificate"), "tls"
    if encryption.certificate is None:
        state = Message("system_in_clear" if encryption.is_missing else "system_this_machine_only")
        to_do = Message("system_set_certificate") if encryption.is_missing else None
        return SystemRow(name, state, to_do=to_do, help=chapter)
    state = Message.of("system_certificate_ends", day=encryption.certificate.ends_on)
    return SystemRow(name, encryption.fault or state, help=chapter)


def _peers(services: Services, now: UnixTime, monotonic: Monotonic) -> Iterator[SystemRow]:
    for peer in services[LineTiles].board.peers:
        age, fault = peer.age_s(monotonic), peer.fault
        name, last = Message.of("system_peer", name=peer.name), None if age is None else now - age
        check = Message("system_check_peer") if fault else None
        yield _link(name, fault or Message("system_peer_is_read"), last, fault, check, "several-lines")


router = APIRouter(include_in_schema=False, route_class=GuardedRoute)


@router.get("/system", dependencies=[SEARCH])
async def system_page(request: Request, _: Viewer) -> Response:
    """Show the safeguards of this server's records: state, last and next time, and actions."""
    services: Services = request.app.state.services
    rows = await system_rows(services, unix_now(), monotonic_now())
    return render(request, "system/page.html", rows=rows)


def make(_: Services) -> None:
    """Add no service: the page shows those of others."""


FEATURE = Feature(make, (router,))
