"""Whether this machine can run a configuration. Nothing is changed and no port is opened."""

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
from app.cli.counted import counted
from app.cli.finding import Finding, can_make_folder, is_visible, user
from app.cli.listening import ListenError, listen
from app.settings import ServerSettings, Settings
from bus.line.port.open_error import why_not
from bus.settings import BusSettings

NO_BUS = (
    "there is no [[bus]], so there is nothing to show. Write one for each cable, with its name, its port and "
    "its [[bus.unit]] tables; 'lineside init --config FILE' writes a file to start from."
)


def findings(settings: Settings) -> Iterator[Finding]:
    """Everything worth knowing of a configuration on this machine, in the order of the file."""
    yield _address(settings.server)
    yield _data(settings.server.data)
    yield from audit_findings(settings)
    if not settings.bus:
        yield Finding(NO_BUS, is_fault=True)
    for bus in settings.bus:
        yield from _bus(bus)


def _address(server: ServerSettings) -> Finding:
    where = f"dashboard at {server.host} port {server.port}"
    try:
        listen(server.host, server.port, "choose another").close()
    except ListenError as error:
        if getattr(error.__cause__, "errno", None) == errno.EADDRINUSE:
            return Finding(f"{where}, which is in use now: by a running Lineside, or by another program")
        return Finding(f"[server]: {error}", is_fault=True)
    return Finding(where)


def _data(folder: Path) -> Finding:
    existing = next(each for each in (folder, *folder.parents) if is_visible(each))
    if not existing.is_dir():
        return Finding(f"data: {existing} is no folder. Name another one as data in [server].", is_fault=True)
    if not can_make_folder(folder):
        what = "write to" if existing == folder else "create"
        return Finding(
            f"data: {user()} may not {what} {folder}. Give the folder to the user that runs Lineside, name "
            "another one as data in [server], or run this check as that user.",
            is_fault=True,
        )
    later = "" if existing == folder else ", created at the first start"
    return Finding(f"data in {folder}{later}")


def _bus(bus: BusSettings) -> Iterator[Finding]:
    fault = _url_fault(bus.port) if "://" in bus.port else _device_fault(bus.port)
    if fault:
        yield Finding(f"bus {bus.name}: {fault}", is_fault=True)
        return
    absent = ""
    if "://" not in bus.port and not Path(bus.port).exists():
        absent = ", which is not there now; Lineside waits for it"
    yield Finding(f"bus {bus.name}: {counted(len(bus.unit), 'unit')} at {bus.port}{absent}, {bus.baud} baud")
    if not bus.unit:
        scan = f"'lineside scan --port {bus.port}' lists the addresses that respond"
        yield Finding(f"bus {bus.name} has no [[bus.unit]]; {scan}")


def _device_fault(path: str) -> str:
    try:
        status = Path(path).stat()
    except FileNotFoundError:
        return ""
    except OSError as error:
        return f"{why_not(path, error)}."
    if not stat.S_ISCHR(status.st_mode) or _is_other_device(status.st_rdev):
        return (
            f"{why_not(path, OSError(errno.ENOTTY, ''))}. Name a device, such as one in /dev/serial/by-id/."
        )
    return "" if os.access(path, os.R_OK | os.W_OK) else f"{why_not(path, OSError(errno.EACCES, ''))}."


def _is_other_device(device: int) -> bool:
    """Whether Linux knows it as something else than a terminal; a pseudo-terminal is not known."""
    subsystem = Path(f"/sys/dev/char/{os.major(device)}:{os.minor(device)}/subsystem")
    return subsystem.exists() and subsystem.resolve().name != "tty"


def _url_fault(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme == "rfc2217" and importlib.util.find_spec("serialx") is None:
        return f"{url} needs one more package: pip install 'lineside[rfc2217]'."
    try:
        socket.getaddrinfo(parts.hostname, parts.port, type=socket.SOCK_STREAM)
    except (socket.gaierror, UnicodeError):
        return (
            f"{url} names a host that this machine does not know. Check its spelling, or give its IP address."
        )
    return ""
