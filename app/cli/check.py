"""The command ``lineside check``: the configuration, this machine, and the devices and servers that it names.

With ``--live`` the command tries what the configuration names. Every trial is undone, nothing is sent, and a
running Lineside is left alone.
"""

from __future__ import annotations

import asyncio
import json
import os
import socket
import sys
from collections.abc import Awaitable, Iterator, Mapping, Sequence
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from itertools import pairwise
from pathlib import Path
from secrets import token_hex
from urllib.parse import urlsplit

import click

from app.cli.command import become_owner_of, complain, config_option, json_option, report
from app.cli.findings import (
    OF_MACHINE,
    Check,
    Finding,
    bus_refusal,
    fault,
    info,
    is_visible,
    may_make_files_in,
    user,
)
from app.cli.starting import ListenError, PortInUse, listen, url_of
from app.cli.status import GB, is_opcua_server, is_serving, peer_faults, verification
from app.core.database.connection import examining, has_table
from app.core.database.files import free_bytes
from app.core.database.migration import presence_of, refuse_newer
from app.core.server.settings import SecretFileError, can_others_read, read_secret_text
from app.core.web.shape import message_shown
from app.errors import StoreError
from app.people.audit.anchor import anchor_file
from app.people.auth.settings import OidcSettings
from app.people.auth.single_sign_on import provider_of, require_package
from app.records.notification.rules import NotDeliveredError, NotificationEndpoint, NotificationPlan
from app.records.notification.senders import apprise_service, reach_hook, reach_mail_server
from app.records.notification.settings import AppriseSettings, NotifySettings, WebhookSettings
from app.settings import LOCK_FILE, ServerSettings, Settings, load
from app.system.mqtt.session import connected, identifier_for
from app.system.mqtt.settings import MqttSettings
from app.system.opcua.process import require_package as require_asyncua
from app.system.postgresql.destination import Destination
from app.system.postgresql.outbox import read_identity
from app.system.postgresql.publisher import PublisherStatus
from bus.errors import LinesideError
from bus.instants import unix_now
from bus.line.port import used_by, users_of
from bus.messages import Message, ParamValue, number
from bus.settings import BusSettings

PortUsers = Mapping[str, Sequence[tuple[int, str]]]
"""The process id and name of each program that has a bus's port open, by bus."""
_PROC = Path("/proc")
_LOCKS = _PROC / "locks"
_ESTABLISHED = "01"
_WORD_BYTES = 4
"""The bytes of each word of an address in ``/proc/net/tcp``, a number of this machine (proc_net_tcp(5))."""


def live_findings(settings: Settings, users: PortUsers) -> Iterator[Finding]:
    """Try everything that can be tried, in the order of the file. ``users``: the programs at the serial
    ports."""
    serves = _serves(settings.server)
    has_lock = is_locked(settings.server.data / LOCK_FILE)
    yield info("live_user", user=user())
    yield from _address(settings.server, has_lock=has_lock, serves=serves)
    yield from _folders(settings)
    yield from _store(settings)
    yield from port_findings(settings, users, server_runs=bool(has_lock) or serves)


def is_locked(file: Path) -> bool | None:
    """Return whether a process has a lock on the file, None if this user cannot see that. The lock is looked
    up: trying it would keep a server from taking it."""
    try:
        inode, lines = file.stat().st_ino, _LOCKS.read_text().splitlines()
    except FileNotFoundError:
        return False
    except OSError:
        return None
    return any(word.endswith(f":{inode}") for line in lines for word in line.split()[5:6])


def _url(server: ServerSettings) -> str:
    return url_of(server.host, server.port, "http" if server.tls is None else "https")


def _serves(server: ServerSettings) -> bool:
    own, _ = verification(server.tls)
    return bool(server.port) and is_serving(_url(server), own)


def _address(server: ServerSettings, *, has_lock: bool | None, serves: bool) -> Iterator[Finding]:
    place: dict[str, ParamValue] = {"host": server.host, "port": server.port}
    if serves and has_lock is False:
        yield fault("live_address_of_other", url=_url(server), folder=str(server.data))
    elif serves:
        yield info("live_address_own", url=_url(server))
    elif server.port:
        try:
            listen(server.host, server.port, Message("choose_port")).close()
        except PortInUse as error:
            stalled = fault("live_address_stalled", **place, folder=str(server.data))
            yield stalled if has_lock else fault("check_server_refused", reason=error.message)
        except ListenError:
            return  # found by `lineside check`
        else:
            yield info("live_address_free", **place)


def _folders(settings: Settings) -> Iterator[Finding]:
    """Report the folders in which a running server writes, unless `lineside check` has found a fault
    there."""
    data = settings.server.data
    inner = sorted(_entries(data))
    folders = [data, *(each for each in inner if each.is_dir() and not each.is_symlink())]
    for folder in dict.fromkeys(
        (*folders, settings.backup.folder, anchor_file(settings.audit, settings.key_files).parent)
    ):
        if folder is not None and is_visible(folder) and may_make_files_in(folder):
            free = number(f"{free_bytes(folder) / GB:.1f}")
            yield info("live_folder", folder=str(folder), user=user(), free=free)
    for path in inner:
        if not os.access(path, os.R_OK | os.W_OK):
            yield fault("live_file_not_writable", user=user(), path=str(path), folder=str(data))


def _entries(data: Path) -> Iterator[Path]:
    """Yield everything below a folder, as far as this user may look."""
    for folder, folders, files in os.walk(data):
        yield from (Path(folder, name) for name in (*folders, *files))


def _store(settings: Settings) -> Iterator[Finding]:
    """Compare the tables of the main store with those of this version."""
    store = settings.server.store
    try:
        if presence_of(store) != "sound":
            return
        with examining(store) as connection:
            steps = refuse_newer(connection, store)
    except StoreError:
        return  # found by `lineside check`
    yield info("live_store_earlier" if steps else "live_store", path=str(store), n=len(steps))


def port_users(settings: Settings) -> PortUsers:
    """Return the programs at the serial ports. Only root sees those of every user."""
    return {bus.name: users_of(bus.port) for bus in settings.bus if bus.has_local_port}


def port_findings(settings: Settings, users: PortUsers, *, server_runs: bool) -> Iterator[Finding]:
    """Try each port that the server uses, unless `lineside check` has already refused it."""
    for bus in settings.bus:
        if bus.worker == "server" and bus_refusal(bus) is None:
            yield _server(bus, runs=server_runs) if "://" in bus.port else _device(bus, users)


def _device(bus: BusSettings, users: PortUsers) -> Finding:
    using = users[bus.name]
    own = [pid for pid, _ in using if is_worker_of(bus.name, pid)]
    if own and len(own) == len(using):
        return info("live_port_own", bus=bus.name, port=bus.port, pid=own[0])
    if using:
        return fault("check_port_refused", bus=bus.name, reason=used_by(bus.port, using))
    return _opened(bus, "live_port_opens")


def _server(bus: BusSettings, *, runs: bool) -> Finding:
    place = {"bus": bus.name, "port": bus.port}
    if runs:
        return info("live_port_of_server", **place)
    if is_connected_to(bus.port):
        return info("live_port_connected", **place)
    return _opened(bus, "live_port_connects")


def _opened(bus: BusSettings, code: str) -> Finding:
    # Imported only here: most commands open no port.
    from bus.line.opener import port_fault

    reason = port_fault(bus.port)
    if bus.has_local_port and not Path(bus.port).exists():
        # As `lineside check` says, the server waits for the port. This finding adds the ports that exist.
        return info("check_port_refused", bus=bus.name, reason=reason or "")
    if reason is not None:
        return fault("check_port_refused", bus=bus.name, reason=reason)
    return info(code, bus=bus.name, port=bus.port)


def is_worker_of(bus: str, pid: int) -> bool:
    """Return whether a process is the worker of a bus: a server's child, or ``lineside worker``."""
    try:
        words = (_PROC / str(pid) / "cmdline").read_text().split("\0")
    except (OSError, UnicodeDecodeError):
        return False
    named = f"--bus={bus}" in words or ("--bus", bus) in pairwise(words)
    return named and ("worker" in words or ("-m", "bus") in pairwise(words))


def is_connected_to(url: str) -> bool:
    """Return whether a program of this machine has a connection to a URL's device server."""
    parts = urlsplit(url)
    try:
        found = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    servers = {(ip_address(str(place[0])), place[1]) for *_, place in found}
    return any(remote in servers for remote in _remotes())


def _remotes() -> Iterator[tuple[IPv4Address | IPv6Address, int]]:
    """Yield the remote end of each connection of this machine."""
    for name in ("tcp", "tcp6"):
        with suppress(OSError):
            for line in (_PROC / "net" / name).read_text().splitlines()[1:]:
                _, _, remote, state, *_ = line.split()
                if state == _ESTABLISHED:
                    address, _, port = remote.partition(":")
                    yield _decoded(bytes.fromhex(address)), int(port, 16)


def _decoded(written: bytes) -> IPv4Address | IPv6Address:
    words = [written[at : at + _WORD_BYTES] for at in range(0, len(written), _WORD_BYTES)]
    return ip_address(b"".join(word[::-1] if sys.byteorder == "little" else word for word in words))


CHECK_S = 15.0


@click.command
@config_option
@click.option(
    "--live",
    is_flag=True,
    help="Try what the configuration names: ports, folders, certificates, address, store. Nothing is"
    " sent to a unit, and a running Lineside is left alone.",
)
@json_option
def check(config: Path, live: bool, as_json: bool) -> None:
    """Check the configuration and this machine; list faults by file and line. Exit 0 or 1."""
    settings = load(config)
    found = [*_found_of(settings, config.absolute(), live=live)]
    if as_json:
        shown = [{"fault": each.is_fault, **message_shown(each.message)} for each in found]
        click.echo(json.dumps({"config": str(config), "site": settings.site.name, "findings": shown}))
    else:
        report(Message.of("check_configuration", file=str(config), site=settings.site.name))
        for finding in found:
            if finding.is_fault:
                complain(finding.message)
            else:
                click.echo(f"  {finding.message}")
    if any(finding.is_fault for finding in found):
        raise click.exceptions.Exit(1)


def _found_of(settings: Settings, config: Path, *, live: bool) -> Iterator[Finding]:
    """Check with the service's rights, also if root calls: files that it may not read are faults."""
    users = port_users(settings) if live else {}  # root sees the programs of every user
    become_owner_of(settings.server.data)
    if not os.access(config, os.R_OK):
        yield fault("live_configuration_unreadable", user=user(), file=str(config))
    for each in (*OF_MACHINE, *OF_NETWORK):
        yield from each(settings)
    if live:
        yield from live_findings(settings, users)
        yield from postgresql(settings)
        yield from peers(settings)
        yield from mqtt(settings)
        yield from opcua(settings)


def _open_secrets(*files: Path | None) -> Iterator[Finding]:
    """Name the files of secrets that every user of this machine can read."""
    yield from (info("check_secret_open", path=str(path)) for path in files if path and can_others_read(path))


def oidc(settings: Settings) -> Iterator[Finding]:
    """Try the package, the file of the secret, and the provider of company accounts (only reading)."""
    if (wanted := settings.oidc) is None:
        return
    try:
        require_package()
    except LinesideError as error:
        yield Finding(error.message, is_fault=True)
        return
    try:
        read_secret_text(wanted.client_secret_file)
    except SecretFileError as error:
        yield Finding(error.message, is_fault=True)
    yield from _open_secrets(wanted.client_secret_file)
    reason = asyncio.run(_provider_fault(wanted))
    if reason is not None:
        yield fault("check_oidc_failed", issuer=wanted.issuer, reason=reason)
    else:
        yield info("check_oidc", issuer=wanted.issuer)


async def _provider_fault(settings: OidcSettings) -> Message | None:
    provider = provider_of(settings)
    try:
        await provider.refresh()
    finally:
        await provider.close()
    return provider.fault


def notification(site: Settings) -> Iterator[Finding]:
    """Try the mail server, each program, each roster, and the files of secrets. Send nothing."""
    settings = site.notify
    plan = NotificationPlan(settings)
    for name in plan.rosters:
        yield from (Finding(message, is_fault=True) for message in plan.gaps(name))
    if plan.endpoints and settings.dashboard_url is None:
        yield info("check_notify_no_links")
    yield from _open_secrets(*_secret_files(settings))
    if settings.smtp is not None:
        place = f"{settings.smtp.host}:{settings.smtp.port}"
        yield _tried(place, reach_mail_server(settings.smtp), "mail")
    for endpoint in plan.endpoints.values():
        if endpoint.settings is not None:
            yield _tried(endpoint.address, _reach(endpoint), endpoint.kind)


async def _reach(endpoint: NotificationEndpoint) -> None:
    match endpoint.settings:
        case WebhookSettings() as settings:
            await reach_hook(settings)
        case AppriseSettings() as settings:
            apprise_service(settings)


def _tried(address: str, attempt: Awaitable[None], kind: str) -> Finding:
    try:
        asyncio.run(_bounded(attempt))
    except LinesideError as error:
        return fault("check_notify_failed", address=address, reason=error.message)
    return Finding(Message.of(f"check_notify_{kind}", address=address))


async def _bounded(attempt: Awaitable[None]) -> None:
    try:
        async with asyncio.timeout(CHECK_S):
            await attempt
    except TimeoutError:
        raise NotDeliveredError(Message.of("notify_took_too_long", seconds=round(CHECK_S))) from None


def _secret_files(settings: NotifySettings) -> Iterator[Path | None]:
    yield None if settings.smtp is None else settings.smtp.password_file
    for hook in settings.webhook:
        yield from (hook.secret_file, hook.url_file)
    yield from (each.url_file for each in settings.apprise)


def postgresql(settings: Settings) -> Iterator[Finding]:
    """Try the plant's database: the file of its password, the server, the rights, the tables, the clocks."""
    to = settings.postgresql
    if to is None:
        return
    yield from _open_secrets(to.password_file)
    destination = Destination(to, settings.site.name, _identity(settings), settings.bus)
    try:
        ahead = destination.examine()
    except StoreError as error:
        yield Finding(error.message, is_fault=True)
        return
    finally:
        destination.abandon()
    yield info("check_postgresql", place=to.place, schema=to.db_schema)
    notice = PublisherStatus(to.place, unix_now(), clock_ahead_s=ahead).notice
    if notice is not None:
        yield Finding(notice, is_fault=True)


def _identity(settings: Settings) -> str:
    """Return the identity in the store, or before the first start a new one that no database knows."""
    try:
        with examining(settings.server.store) as connection:
            if has_table(connection, "publisher_identity"):
                return read_identity(connection)
    except StoreError:
        pass  # found by the check of the stores
    return token_hex(16)


def mqtt(settings: Settings) -> Iterator[Finding]:
    """Try the plant's broker, and look at the files of the password and the key."""
    to = settings.mqtt
    if to is None:
        return
    yield from _open_secrets(to.password_file)
    yield from _open_secrets(to.key)
    if to.is_in_clear:
        yield info("check_mqtt_in_clear", place=to.place)
    try:
        asyncio.run(_try_broker(to))
    except LinesideError as error:
        yield Finding(error.message, is_fault=True)
    else:
        yield info("check_mqtt", place=to.place)


async def _try_broker(to: MqttSettings) -> None:
    """Connect to the broker under an unused name. Raise BrokerError."""
    async with connected(to, identifier_for(token_hex(8))):
        pass


def opcua(settings: Settings) -> Iterator[Finding]:
    """Report whether OPC UA is served, by the first message of its protocol."""
    if settings.opcua is None:
        return
    try:
        require_asyncua()
    except LinesideError as error:
        yield Finding(error.message, is_fault=True)
        return
    host, port = settings.opcua_address
    place = f"{host}:{port}"
    try:
        is_served = asyncio.run(is_opcua_server(host, port))
    except OSError:
        yield info("check_opcua_off", place=place)
    else:
        yield info("check_opcua", place=place) if is_served else fault("check_opcua_other", place=place)


def peers(settings: Settings) -> Iterator[Finding]:
    """Read each peer once, and look at the files of their tokens."""
    for peer in settings.peer:
        yield from _open_secrets(peer.token_file)
        if peer.is_in_clear:
            yield info("check_peer_in_clear", peer=peer.name, url=peer.url)
    for peer, reason in peer_faults(settings):
        if reason is None:
            yield info("check_peer", peer=peer.name, url=peer.url)
        else:
            yield fault("peer_not_read", peer=peer.name, reason=reason)


OF_NETWORK: tuple[Check, ...] = (oidc, notification)
"""The checks that call other machines."""
