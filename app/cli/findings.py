"""Whether this machine can run a configuration. What is tried is undone, and no port is opened."""

from __future__ import annotations

import errno
import importlib.util
import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from app.cli.audit_findings import audit_findings
from app.cli.finding import Finding, can_make_folder, fault, is_visible, user
from app.cli.listening import ListenError, listen
from app.cli.notification_findings import notification_findings
from app.settings import ServerSettings, Settings
from bus.line.port.open_error import why_not
from bus.messages import Message
from bus.settings import BusSettings


def findings(settings: Settings) -> Iterator[Finding]:
    """Everything worth knowing of a configuration on this machine, in the order of the file."""
    yield _address(settings.server)
    yield _data(settings.server.data)
    yield from audit_findings(settings)
    if not settings.bus:
        yield fault("check_no_bus")
    for bus in settings.bus:
        yield from _bus(bus)
    yield from notification_findings(settings.notify)


def _address(server: ServerSettings) -> Finding:
    try:
        listen(server.host, server.port, Message("choose_port")).close()
    except ListenError as error:
        if getattr(error.__cause__, "errno", None) == errno.EADDRINUSE:
            return Finding(Message.of("check_address_in_use", host=server.host, port=server.port))
        return fault("check_server_refused", reason=error.message)
    return Finding(Message.of("check_address", host=server.host, port=server.port))


def _data(folder: Path) -> Finding:
    existing = next(each for each in (folder, *folder.parents) if is_visible(each))
    if not existing.is_dir():
        return fault("check_data_is_file", folder=str(existing))
    if not can_make_folder(folder):
        code = "check_data_not_writable" if existing == folder else "check_data_not_creatable"
        return fault(code, user=user(), folder=str(folder))
    return Finding(Message.of("check_data" if existing == folder else "check_data_later", folder=str(folder)))


def _bus(bus: BusSettings) -> Iterator[Finding]:
    refusal = _url_fault(bus) if "://" in bus.port else _device_fault(bus)
    if refusal is not None:
        yield Finding(refusal, is_fault=True)
        return
    absent = "://" not in bus.port and not Path(bus.port).exists()
    code = "check_bus_absent" if absent else "check_bus"
    yield Finding(Message.of(code, bus=bus.name, n=len(bus.unit), port=bus.port, baud=bus.baud))
    if not bus.unit:
        yield Finding(Message.of("check_bus_without_units", bus=bus.name, port=bus.port))


def _device_fault(bus: BusSettings) -> Message | None:
    path = bus.port
    try:
        status = Path(path).stat()
    except FileNotFoundError:
        return None
    except OSError as error:
        return Message.of("check_port_refused", bus=bus.name, reason=why_not(path, error))
    if not stat.S_ISCHR(status.st_mode) or _is_other_device(status.st_rdev):
        return Message.of(
            "check_port_no_device", bus=bus.name, reason=why_not(path, OSError(errno.ENOTTY, ""))
        )
    if os.access(path, os.R_OK | os.W_OK):
        return None
    return Message.of("check_port_refused", bus=bus.name, reason=why_not(path, OSError(errno.EACCES, "")))


def _is_other_device(device: int) -> bool:
    """Whether Linux knows it as something else than a terminal; a pseudo-terminal is not known."""
    subsystem = Path(f"/sys/dev/char/{os.major(device)}:{os.minor(device)}/subsystem")
    return subsystem.exists() and subsystem.resolve().name != "tty"


def _url_fault(bus: BusSettings) -> Message | None:
    parts = urlsplit(bus.port)
    if parts.scheme == "rfc2217" and importlib.util.find_spec("serialx") is None:
        return Message.of("check_port_needs_package", bus=bus.name, port=bus.port)
    try:
        socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (socket.gaierror, UnicodeError):
        return Message.of("check_port_host_unknown", bus=bus.name, port=bus.port)
    return None
