"""What ``lineside check --live`` finds: what the configuration names is tried. Every trial is undone, nothing
is sent, and a running Lineside is left alone.
"""

from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlsplit

from app.cli.findings import Finding, bus_refusal, fault, info, is_visible, may_make_files_in, user
from app.cli.starting import ListenError, PortInUse, listen, url_of
from app.cli.status import GB, is_serving, verification
from app.core.database.connection import examining
from app.core.database.files import free_bytes
from app.core.database.migration import presence_of, refuse_newer
from app.errors import StoreError
from app.people.audit.anchor import anchor_file
from app.settings import LOCK_FILE, ServerSettings, Settings
from bus.line.port import used_by, users_of
from bus.messages import Message, ParamValue, number
from bus.settings import BusSettings

PortUsers = Mapping[str, Sequence[tuple[int, str]]]
"""By bus: process id and name of each program that has its port open."""
_PROC = Path("/proc")
_LOCKS = _PROC / "locks"
_ESTABLISHED = "01"
_WORD_BYTES = 4
"""Of an address in ``/proc/net/tcp``: each word is written as a number of this machine (proc_net_tcp(5))."""


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
    """Return whether a process has a lock on the file, None if this user cannot see that. It is looked up:
    trying it would keep a server from it."""
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
    """Report the folders in which a running server writes, unless `lineside check` has found a fault in
    them."""
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
    """Return everything below a folder, as far as this user may look."""
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
    """Try each port that the server uses, unless `lineside check` has refused it already."""
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
    # Not imported with the commands that open no port.
    from bus.line.opener import port_fault

    reason = port_fault(bus.port)
    if bus.has_local_port and not Path(bus.port).exists():
        # As `lineside check` says: it is waited for. Here with the ports that there are instead.
        return info("check_port_refused", bus=bus.name, reason=reason or "")
    if reason is not None:
        return fault("check_port_refused", bus=bus.name, reason=reason)
    return info(code, bus=bus.name, port=bus.port)


def is_worker_of(bus: str, pid: int) -> bool:
    """Return whether a process is the worker of a bus: a child of the server, or ``lineside worker``."""
    try:
        words = (_PROC / str(pid) / "cmdline").read_text().split("\0")
    except (OSError, UnicodeDecodeError):
        return False
    named = f"--bus={bus}" in words or ("--bus", bus) in pairwise(words)
    return named and ("worker" in words or ("-m", "bus") in pairwise(words))


def is_connected_to(url: str) -> bool:
    """Return whether a program of this machine has a connection to the device server of a URL."""
    parts = urlsplit(url)
    try:
        found = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    servers = {(ip_address(str(place[0])), place[1]) for *_, place in found}
    return any(remote in servers for remote in _remotes())


def _remotes() -> Iterator[tuple[IPv4Address | IPv6Address, int]]:
    """Return the other end of each connection of this machine."""
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
