"""The command ``lineside status``: a site on one screen, whether its dashboard runs or not: dashboard, buses,
stores, disk, certificates, backups, plant's database and peers. Nothing is created or changed."""

from __future__ import annotations

import asyncio
import json
import ssl
import struct
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import click
import httpx

from app.cli.command import bearer_token, config_option, json_option, report, token_file_option, token_option
from app.cli.dashboard import dashboard
from app.cli.findings import backup_folder_fault, certificate_files, existing_part
from app.cli.starting import url_of
from app.core.database.connection import examining, has_table
from app.core.database.files import free_bytes
from app.core.server.settings import TlsSettings
from app.core.web.shape import iso, maybe_shown
from app.errors import StoreError
from app.line.history.service import seconds
from app.line.history.status import MAX_DAYS
from app.records.handover.rules import site_time
from app.settings import Settings, load
from app.system.backup.folder import next_due
from app.system.backup.service import newest_in
from app.system.mqtt.backlog import read_backlog
from app.system.peers.client import fault_of
from app.system.peers.settings import PeerSettings
from app.system.postgresql.outbox import read_cursor
from app.system.state.disk import forecast, store_sizes
from app.version import VERSION
from bus.errors import LinesideError
from bus.instants import HOUR_S, UnixTime, unix_now
from bus.messages import Message, number
from bus.settings import BusSettings
from bus.tls import TlsFileError, read_certificate

ACKNOWLEDGES_WITHIN_S = 10.0
MAX_ACKNOWLEDGE = 28
EVERY_ADDRESS = {"0.0.0.0": "127.0.0.1", "::": "::1"}


async def is_opcua_server(host: str, port: int) -> bool:
    """Return whether an OPC UA server listens there: it acknowledges a hello. Raise OSError if nothing
    listens."""
    host = EVERY_ADDRESS.get(host, host)
    reader, writer = await asyncio.open_connection(host, port)
    try:
        writer.write(_hello(f"opc.tcp://{host}:{port}/"))
        async with asyncio.timeout(ACKNOWLEDGES_WITHIN_S):
            return (await reader.read(MAX_ACKNOWLEDGE)).startswith(b"ACKF")
    except TimeoutError:
        return False
    finally:
        writer.close()


def _hello(url: str) -> bytes:
    """Return a hello with the usual sizes of buffers, for messages of any size."""
    text = url.encode()
    body = struct.pack("<5Ii", 0, 65_535, 65_535, 0, 0, len(text)) + text
    return b"HELF" + struct.pack("<I", 8 + len(body)) + body


WITHIN_S = 5.0
MB, GB = 1e6, 1e9
NO_CHECK_TIME = 0x200000
"""X509_V_FLAG_NO_CHECK_TIME (openssl/x509_vfy.h), which the module ssl does not name."""


@click.command
@config_option
@token_option
@token_file_option
@json_option
def status(config: Path, token: str, token_file: Path | None, as_json: bool) -> None:
    """Show whether the dashboard serves, the version, the stores with their sizes, how long the disk lasts,
    the ends of certificates, and the newest and the next backup; with a token of any role but worker also the
    state of each bus and the faults of the server.

    Exit 0 when it serves, else 1.
    """
    settings, bearer = load(config), bearer_token(token, token_file, required=False)
    tls = settings.server.tls
    own, fault = verification(tls)
    url = url_of(settings.server.host, settings.server.port, "http" if tls is None else "https")
    serves = is_serving(url, own)
    # A token is sent only to the configured certificate.
    buses, degraded = _state(url, bearer, own) if serves and bearer and fault is None else (None, None)
    if fault is not None:
        degraded = [{"code": fault.code, "since": None, "message": str(fault)}]
    facts = list(_site_facts(settings, unix_now()))
    if as_json:
        shown = {"serving": serves, "url": url, "store": str(settings.server.store), "buses": buses}
        shown |= {"degraded": degraded} | {name: fact for each in facts for name, fact in each.shown.items()}
        click.echo(json.dumps(shown))
    else:
        code = "dashboard_serves" if serves else "dashboard_is_off"
        report(Message.of(code, site=settings.site.name, url=url, version=VERSION))
        lines = map(_configured, settings.bus) if buses is None else map(_line, buses)
        for line in (*lines, *(line for each in facts for line in each.lines)):
            click.echo(f"  {line}")
        for each in degraded or ():
            report(Message.of("site_degraded", fault=each["message"]))
        if serves and not bearer:
            report(Message("status_needs_token"))
    if not serves:
        raise LinesideError(Message.of("not_serving", url=url, config=str(config)))


class Facts(NamedTuple):
    """Facts of a site for programs (bytes, days, ISO 8601), and the same as lines of text."""

    shown: dict[str, Any]
    lines: list[Message]


def _site_facts(settings: Settings, now: UnixTime) -> Iterator[Facts]:
    """Read the files of a site, and each of its peers once."""
    buses = [
        {"name": bus.name, "port": bus.port, "baud": bus.baud, "units": len(bus.unit)} for bus in settings.bus
    ]
    yield Facts({"site": settings.site.name, "version": VERSION, "configured": buses}, [])
    yield disk_facts(settings, now)
    yield certificate_facts(settings)
    yield backup_facts(settings, now)
    yield _publisher_facts(settings, now)
    yield _node_facts(settings, now)
    yield _peer_facts(settings)
    yield _opcua_facts(settings)


def disk_facts(settings: Settings, now: UnixTime) -> Facts:
    """Read the sizes of the stores, and estimate how long the free space of their disk lasts."""
    data = settings.server.data
    stores = store_sizes(data)
    free = free_bytes(existing_part(data))
    days = forecast(settings, stores, free, now)
    lines = [Message.of("dashboard_store", path=str(settings.server.store))]
    lines += [
        Message.of("status_store", name=name, size=number(f"{size / MB:.1f}"))
        for name, size in stores.items()
    ]
    free_gb = number(f"{free / GB:.1f}")
    if days is None:
        lines.append(Message.of("status_disk_unknown", free=free_gb))
    else:
        code = "status_disk_long" if days >= MAX_DAYS else "status_disk"
        lines.append(Message.of(code, free=free_gb, n=int(days)))
    disk_days = None if days is None else round(days, 1)
    return Facts({"stores": stores, "disk_free": free, "disk_days": disk_days}, lines)


def certificate_facts(settings: Settings) -> Facts:
    """Read the end date of each certificate."""
    shown, lines = [], []
    for file, certificate in certificate_files(settings):
        shown.append({"file": file, "ends": None if certificate is None else iso(certificate.ends_at)})
        if certificate is None:
            lines.append(Message.of("status_certificate_unreadable", file=file))
        else:
            lines.append(Message.of("status_certificate", file=file, day=certificate.ends_on))
    return Facts({"certificates": shown}, lines)


def backup_facts(settings: Settings, now: UnixTime) -> Facts:
    """Read when the newest backup began, when the next is due, and why none can be written now."""
    folder = settings.backup.folder
    if folder is None:
        return Facts({"backup": None}, [Message("status_no_backup")])
    zone = ZoneInfo(settings.site.zone)
    newest, fault = newest_in(folder, now, zone), backup_folder_fault(settings)
    due = max(now, next_due(now, newest, None, settings.backup, zone))
    shown = {
        "folder": str(folder),
        "is_there": folder.is_dir(),
        "fault": None if fault is None else str(fault),
        "newest": None if newest is None else iso(newest),
        "next": iso(due),
    }
    if fault is not None:
        line = Message.of("status_backup_fault", reason=fault)
    elif newest is None:
        line = Message.of("status_backup_first", folder=str(folder), due=site_time(due, zone))
    else:
        hours = int((now - newest) / HOUR_S)
        times = {"newest": site_time(newest, zone), "due": site_time(due, zone)}
        line = Message.of("status_backup", hours=hours, **times)
    return Facts({"backup": shown}, [line])


def _publisher_facts(settings: Settings, now: UnixTime) -> Facts:
    """Read the time up to which the plant's database is complete, as far as the store knows."""
    if settings.postgresql is None:
        return Facts({"publisher": None}, [])
    place, until = settings.postgresql.place, None
    with suppress(StoreError), examining(settings.server.store) as connection:
        if has_table(connection, "publisher_cursor") and (cursor := read_cursor(connection)):
            until = seconds(cursor.until)
    if until is None:
        shown = {"database": place, "until": None, "lag_s": None}
        return Facts({"publisher": shown}, [Message.of("status_publisher_first", place=place)])
    lag = max(0, int(now - until))
    time = site_time(until, ZoneInfo(settings.site.zone))
    line = Message.of("status_publisher", place=place, until=time, seconds=lag)
    return Facts({"publisher": {"database": place, "until": iso(until), "lag_s": lag}}, [line])


def _node_facts(settings: Settings, now: UnixTime) -> Facts:
    """Read the time up to which the broker has all of each line, as far as the store knows."""
    if settings.mqtt is None:
        return Facts({"nodes": []}, [])
    place, zone = settings.mqtt.place, ZoneInfo(settings.site.zone)
    received = dict.fromkeys((bus.name for bus in settings.bus), 0)
    with suppress(StoreError), examining(settings.server.store) as connection:
        if has_table(connection, "mqtt_node"):
            received = {bus.name: read_backlog(connection, bus).received for bus in settings.bus}
    shown, lines = [], []
    for name, until in received.items():
        at, lag = seconds(until), max(0, int(now - seconds(until)))
        known = {"until": iso(at), "lag_s": lag} if until else {"until": None, "lag_s": None}
        shown.append({"broker": place, "node": name} | known)
        if until:
            line = Message.of(
                "status_node", place=place, node=name, until=site_time(at, zone), seconds=number(str(lag))
            )
        else:
            line = Message.of("status_node_first", place=place, node=name)
        lines.append(line)
    return Facts({"nodes": shown}, lines)


def _peer_facts(settings: Settings) -> Facts:
    shown, lines = [], []
    for peer, fault in peer_faults(settings):
        shown.append({"name": peer.name, "url": peer.url, "fault": maybe_shown(fault)})
        if fault is None:
            lines.append(Message.of("check_peer", peer=peer.name, url=peer.url))
        else:
            lines.append(Message.of("peer_not_read", peer=peer.name, reason=fault))
    return Facts({"peers": shown}, lines)


def _opcua_facts(settings: Settings) -> Facts:
    if settings.opcua is None:
        return Facts({"opcua": None}, [])
    host, port = settings.opcua_address
    try:
        serves = asyncio.run(is_opcua_server(host, port))
    except OSError:
        serves = False
    place = f"{host}:{port}"
    code = "check_opcua" if serves else "check_opcua_off"
    return Facts({"opcua": {"address": place, "serves": serves}}, [Message.of(code, place=place)])


def peer_faults(settings: Settings) -> list[tuple[PeerSettings, Message | None]]:
    """Read all peers at the same time, each once; return each with its fault, if any."""

    async def read() -> list[Message | None]:
        return await asyncio.gather(*map(fault_of, settings.peer))

    return list(zip(settings.peer, asyncio.run(read()) if settings.peer else (), strict=True))


def verification(tls: TlsSettings | None) -> tuple[ssl.SSLContext | None, Message | None]:
    """Return a context that verifies this machine's own server, None without TLS; and the fault if its file
    of certificates is damaged: a server that read it before still serves."""
    if tls is None:
        return None, None
    # The context trusts the certificate itself, under any name and at any time: this machine calls itself.
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN | NO_CHECK_TIME
    try:
        context.load_verify_locations(cadata=read_certificate(tls.certificate).der)
    except TlsFileError as error:
        return None, error.message
    return context, None


def is_serving(url: str, own: ssl.SSLContext | None = None) -> bool:
    """Return whether a Lineside dashboard serves at ``url``. ``own``: verifies its certificate; None for
    http, where nothing is verified."""
    try:
        # Without TLS nothing is verified: the authorities of the machine are not read.
        response = httpx.get(f"{url}/healthz", timeout=WITHIN_S, trust_env=False, verify=own or False)
        return response.status_code == 200 and response.json() == {"status": "ok"}
    except (httpx.HTTPError, httpx.InvalidURL, ValueError):
        return False


def _state(
    url: str, token: str, own: ssl.SSLContext | None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return the buses, and the faults of the server."""
    with dashboard(url, token, own) as client:
        line, alarms = client.get("/line"), client.get("/alarms")["alarms"]
    history = line["history"]
    stored = {"code": history["code"], "since": None, "message": history["detail"]} if history else None
    faults = [
        {name: alarm[name] for name in ("code", "since", "message")}
        for alarm in alarms
        if alarm["bus"] is None and alarm["active"]
    ]
    return [_bus(bus) for bus in line["buses"]], [*faults, *([stored] if stored else [])]


def _bus(bus: dict[str, Any]) -> dict[str, Any]:
    shown = ("name", "worker", "link", "link_cause", "scan_hz")
    return {
        **{name: bus.get(name) for name in shown},
        "units": len(bus["units"]),
        "units_online": sum(unit["link"] == "online" for unit in bus["units"]),
    }


def _configured(bus: BusSettings) -> Message:
    return Message.of("check_bus", bus=bus.name, n=len(bus.unit), port=bus.port, baud=bus.baud)


def _line(bus: dict[str, Any]) -> Message:
    units = {"bus": bus["name"], "online": bus["units_online"], "n": bus["units"], "link": bus["link"]}
    if bus["link_cause"]:
        return Message("bus_not_open", {**units, "cause": bus["link_cause"]["detail"]})
    if bus["scan_hz"]:
        return Message("bus_scanned", {**units, "hz": number(f"{bus['scan_hz']:.1f}")})
    return Message("bus_open", units)
