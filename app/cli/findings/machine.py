"""What ``lineside check`` finds: whether this machine can run a configuration. Every trial is undone, and no
port is opened."""

from __future__ import annotations

import errno
import importlib.util
import os
import pwd
import socket
import stat
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from app.audit.anchor import anchor_file
from app.audit.keys import KeyFileError, find_key_file, owners_of, read_key_file
from app.cli.serving.listening import ListenError, listen
from app.settings import ServerSettings, Settings
from bus.line.port.open_error import why_not
from bus.messages import Message, ParamValue
from bus.settings import BusSettings


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


def findings(settings: Settings) -> Iterator[Finding]:
    """Everything worth knowing of a configuration on this machine, in the order of the file."""
    yield from map(Finding, settings.former_notices)
    yield _address(settings.server)
    yield from _encryption(settings.server)
    yield _data(settings.server.data)
    yield _key(settings.key_files, settings.server.store)
    yield _anchor(anchor_file(settings), is_configured=settings.audit.anchor is not None)
    yield from _archive(settings.audit.archive)
    if not settings.bus and not settings.peer:
        yield fault("check_no_bus")
    for bus in settings.bus:
        yield from _bus(bus)


def _encryption(server: ServerSettings) -> Iterator[Finding]:
    if server.tls is None:
        if server.is_in_clear:
            yield Finding(Message("check_no_tls"))
        return
    from app.server.tls.certificate import ServerCertificate
    from bus.tls import TlsFileError, read_certificate

    try:
        fault_now = ServerCertificate(server.tls).fault
        day = read_certificate(server.tls.certificate).ends_on
    except TlsFileError as error:
        yield fault("check_tls_refused", reason=error.message)
        return
    if fault_now is not None:
        yield fault("check_tls_refused", reason=fault_now)
    yield Finding(Message.of("check_certificate", file=str(server.tls.certificate), day=day))


def _address(server: ServerSettings) -> Finding:
    try:
        listen(server.host, server.port, Message("choose_port")).close()
    except ListenError as error:
        if getattr(error.__cause__, "errno", None) == errno.EADDRINUSE:
            return Finding(Message.of("check_address_in_use", host=server.host, port=server.port))
        return fault("check_server_refused", reason=error.message)
    return Finding(Message.of("check_address", host=server.host, port=server.port))


def _data(folder: Path) -> Finding:
    existing = existing_part(folder)
    if not existing.is_dir():
        return fault("check_data_is_file", folder=str(existing))
    if is_read_only(existing):
        return fault("check_disk_read_only", path=str(existing))
    longest = os.pathconf(existing, "PC_NAME_MAX")
    is_too_long = any(len(os.fsencode(name)) > longest for name in folder.parts)
    if is_too_long or not may_make_files_in(existing):
        code = "check_data_not_writable" if existing == folder else "check_data_not_creatable"
        return fault(code, user=user(), folder=str(folder))
    return Finding(Message.of("check_data" if existing == folder else "check_data_later", folder=str(folder)))


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


def _key(paths: Sequence[Path], store: Path | None) -> Finding:
    found = find_key_file(paths)
    if found is None:
        return _new_key(paths)
    try:
        read_key_file(found, owners_of(store if store is not None and is_visible(store) else None))
    except KeyFileError as error:
        return fault("check_key_refused", reason=error.message)
    return Finding(Message.of("check_key", file=str(found)))


def _new_key(paths: Sequence[Path]) -> Finding:
    *others, last = paths
    for path in others:
        if may_make_files_in(path.parent):
            return Finding(Message.of("check_key_new", file=str(path)))
    if not others and not may_make_files_in(last.parent):
        return fault("check_key_not_creatable", user=user(), file=str(last), folder=str(last.parent))
    return Finding(Message.of("check_key_new_beside_data" if others else "check_key_new", file=str(last)))


def _anchor(path: Path, *, is_configured: bool) -> Finding:
    """An anchor at the default place that cannot be written is no fault: the start reports it."""
    exists = is_visible(path)
    # Path.is_symlink raises for a name that is too long.
    if os.path.islink(path) or (exists and not path.is_file()):  # noqa: PTH114
        return fault("check_anchor_no_file", file=str(path))
    if not (os.access(path, os.W_OK) if exists else may_make_files_in(path.parent)):
        return Finding(Message.of("check_anchor_not_writable", user=user(), file=str(path)), is_configured)
    return Finding(Message.of("check_anchor", file=str(path)))


def _archive(folder: Path | None) -> Iterator[Finding]:
    if folder is None:
        return
    if not folder.is_dir():
        yield fault("audit_archive_folder_missing", folder=str(folder))
    elif is_read_only(folder):
        yield fault("check_disk_read_only", path=str(folder))
    elif not may_make_files_in(folder):
        yield fault("check_archive_not_writable", user=user(), folder=str(folder))
    else:
        yield Finding(Message.of("check_archive", folder=str(folder)))
