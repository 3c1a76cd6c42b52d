"""What ``lineside check --live`` finds of the ports: each is opened and given back, and not a byte is sent.
What uses one is looked up before: a second connection to a device server could end that of its worker."""

from __future__ import annotations

import socket
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from itertools import pairwise
from pathlib import Path
from urllib.parse import urlsplit

from app.cli.findings.machine import Finding, bus_refusal, fault
from app.settings import Settings
from bus.line.port.open_error import used_by, users_of
from bus.messages import Message
from bus.settings import BusSettings

PortUsers = Mapping[str, Sequence[tuple[int, str]]]
"""By bus: process id and name of each program that has its port open."""
_PROC = Path("/proc")
_ESTABLISHED = "01"
_WORD_BYTES = 4
"""Of an address in ``/proc/net/tcp``: each word is written as a number of this machine (proc_net_tcp(5))."""


def port_users(settings: Settings) -> PortUsers:
    """The programs at the serial ports. Only root sees those of every user."""
    return {bus.name: users_of(bus.port) for bus in settings.bus if bus.has_local_port}


def port_findings(settings: Settings, users: PortUsers, *, server_runs: bool) -> Iterator[Finding]:
    """Each port that the server uses. One that `lineside check` has refused already is not tried."""
    for bus in settings.bus:
        if bus.worker == "server" and bus_refusal(bus) is None:
            yield _server(bus, runs=server_runs) if "://" in bus.port else _device(bus, users)


def _device(bus: BusSettings, users: PortUsers) -> Finding:
    using = users[bus.name]
    own = [pid for pid, _ in using if is_worker_of(bus.name, pid)]
    if own and len(own) == len(using):
        return Finding(Message.of("live_port_own", bus=bus.name, port=bus.port, pid=own[0]))
    if using:
        return fault("check_port_refused", bus=bus.name, reason=used_by(bus.port, using))
    return _opened(bus, "live_port_opens")


def _server(bus: BusSettings, *, runs: bool) -> Finding:
    place = {"bus": bus.name, "port": bus.port}
    if runs:
        return Finding(Message.of("live_port_of_server", **place))
    if is_connected_to(bus.port):
        return Finding(Message.of("live_port_connected", **place))
    return _opened(bus, "live_port_connects")


def _opened(bus: BusSettings, code: str) -> Finding:
    # Not imported with the commands that open no port.
    from bus.line.port.trial import port_fault

    reason = port_fault(bus.port)
    if bus.has_local_port and not Path(bus.port).exists():
        # As `lineside check` says: it is waited for. Here with the ports that there are instead.
        return Finding(Message.of("check_port_refused", bus=bus.name, reason=reason or ""))
    if reason is not None:
        return fault("check_port_refused", bus=bus.name, reason=reason)
    return Finding(Message.of(code, bus=bus.name, port=bus.port))


def is_worker_of(bus: str, pid: int) -> bool:
    """Whether a process is the worker of a bus: a child of the server, or ``lineside worker``."""
    try:
        words = (_PROC / str(pid) / "cmdline").read_text().split("\0")
    except (OSError, UnicodeDecodeError):
        return False
    named = f"--bus={bus}" in words or ("--bus", bus) in pairwise(words)
    return named and ("worker" in words or ("-m", "bus") in pairwise(words))


def is_connected_to(url: str) -> bool:
    """Whether a program of this machine has a connection to the device server of a URL."""
    parts = urlsplit(url)
    try:
        found = socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return False
    servers = {(_unmapped(ip_address(str(place[0]))), place[1]) for *_, place in found}
    return any(remote in servers for remote in _remotes())


def _remotes() -> Iterator[tuple[IPv4Address | IPv6Address, int]]:
    """The other end of each connection of this machine."""
    for name in ("tcp", "tcp6"):
        with suppress(OSError):
            for line in (_PROC / "net" / name).read_text().splitlines()[1:]:
                _, _, remote, state, *_ = line.split()
                if state == _ESTABLISHED:
                    address, _, port = remote.partition(":")
                    yield _unmapped(_address(bytes.fromhex(address))), int(port, 16)


def _address(written: bytes) -> IPv4Address | IPv6Address:
    words = [written[at : at + _WORD_BYTES] for at in range(0, len(written), _WORD_BYTES)]
    return ip_address(b"".join(word[::-1] if sys.byteorder == "little" else word for word in words))


def _unmapped(address: IPv4Address | IPv6Address) -> IPv4Address | IPv6Address:
    """An address of IPv4 as such, where a socket of IPv6 has the connection."""
    return getattr(address, "ipv4_mapped", None) or address
