"""What ``lineside check`` finds of this machine: address, folders, ports and service. Every trial is undone.
Each function of settings is a row of the table in `check`."""

from __future__ import annotations

import errno
import importlib.util
import os
import pwd
import shutil
import socket
import stat
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from app.cli.serving.listening import ListenError, listen
from app.cli.setup.service_unit import UNIT_FILE
from app.settings import Settings
from bus.line.port import why_not
from bus.messages import Message, ParamValue
from bus.settings import BusSettings

WITHIN_S = 10.0


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report. A fault keeps Lineside from working as configured; the rest informs."""

    message: Message
    is_fault: bool = False


def fault(code: str, /, **params: ParamValue) -> Finding:
    """A fault, by the code of its message."""
    return Finding(Message(code, params), is_fault=True)


def user() -> Message:
    """Return the user whose rights hold now: root's environment still names root once it acts as another."""
    try:
        return Message.of("machine_user", user=pwd.getpwuid(os.geteuid()).pw_name)
    except KeyError:
        return Message.of("machine_user", user=os.geteuid())


def is_visible(path: Path) -> bool:
    """Whether it exists in a folder that this user may look into."""
    try:
        return path.exists()
    except OSError:
        return False


def is_read_only(path: Path) -> bool:
    """Whether its disk is mounted so that nothing can be written."""
    return bool(os.statvfs(path).f_flag & os.ST_RDONLY)


def may_make_files_in(folder: Path) -> bool:
    """Whether it is a folder in which this user can make a file. It is tried: root may write to ``/proc`` and
    still cannot. The file is gone at once."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return False
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"x")
    except OSError:
        return False
    return True


def existing_part(folder: Path) -> Path:
    """The folder, or the nearest of its parents that is there."""
    return next(each for each in (folder, *folder.parents) if is_visible(each))


def former_settings(settings: Settings) -> Iterator[Finding]:
    """Settings of earlier versions, which are ignored."""
    yield from map(Finding, settings.former_notices)


def address(settings: Settings) -> Iterator[Finding]:
    """Whether the dashboard can listen at its address. One in use is no fault: Lineside may be running."""
    server = settings.server
    place: dict[str, ParamValue] = {"host": server.host, "port": server.port}
    try:
        listen(server.host, server.port, Message("choose_port")).close()
    except ListenError as error:
        if getattr(error.__cause__, "errno", None) == errno.EADDRINUSE:
            yield Finding(Message("check_address_in_use", place))
        else:
            yield fault("check_server_refused", reason=error.message)
    else:
        yield Finding(Message("check_address", place))


def data(settings: Settings) -> Iterator[Finding]:
    """Whether the stores can be in the folder of the data."""
    folder = settings.server.data
    existing = existing_part(folder)
    longest = os.pathconf(existing, "PC_NAME_MAX")
    is_too_long = any(len(os.fsencode(name)) > longest for name in folder.parts)
    if not existing.is_dir():
        yield fault("check_data_is_file", folder=str(existing))
    elif is_read_only(existing):
        yield fault("check_disk_read_only", path=str(existing))
    elif is_too_long or not may_make_files_in(existing):
        code = "check_data_not_writable" if existing == folder else "check_data_not_creatable"
        yield fault(code, user=user(), folder=str(folder))
    else:
        code = "check_data" if existing == folder else "check_data_later"
        yield Finding(Message.of(code, folder=str(folder)))


def buses(settings: Settings) -> Iterator[Finding]:
    """The port and the units of each bus."""
    if not settings.bus and not settings.peer:
        yield fault("check_no_bus")
    for bus in settings.bus:
        yield from _bus(bus)


def _bus(bus: BusSettings) -> Iterator[Finding]:
    refusal = bus_refusal(bus) if bus.worker == "server" else None
    if refusal is not None:
        yield Finding(refusal, is_fault=True)
        return
    code = "check_bus" if bus.worker == "server" else "check_bus_remote"
    if bus.has_local_port and not Path(bus.port).exists():
        code = "check_bus_absent"
    yield Finding(Message.of(code, bus=bus.name, n=len(bus.unit), port=bus.port, baud=bus.baud))
    if not bus.unit:
        yield Finding(Message.of("check_bus_without_units", bus=bus.name, port=bus.port))


def bus_refusal(bus: BusSettings) -> Message | None:
    """Why the port of a bus cannot be used, as far as that shows without opening it."""
    return _url_fault(bus) if "://" in bus.port else _device_fault(bus)


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


def service(_: Settings, unit_file: Path = UNIT_FILE) -> Iterator[Finding]:
    """Each line of the unit file that systemd complains of, which it mostly ignores when it starts the
    service: it may have been edited. Nothing without an installed service."""
    program = shutil.which("systemd-analyze")
    if program is None or not unit_file.is_file():
        return
    try:
        done = subprocess.run(
            [program, "verify", unit_file],
            capture_output=True,
            text=True,
            timeout=WITHIN_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return
    complaints = [line for line in done.stderr.splitlines() if unit_file.name in line]
    for line in complaints:
        yield fault("check_service_refused", complaint=line)
    if not complaints:
        yield Finding(Message.of("check_service", file=str(unit_file)))
