"""The findings of ``lineside check`` on this machine and the files of a site. Every trial is undone.

A check is a function of the settings that yields its findings; `OF_MACHINE` has all of them in order.
"""

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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from app.cli.install_service import UNIT_FILE
from app.cli.starting import ListenError, PortInUse, listen
from app.core.database.connection import examining
from app.core.database.files import free_bytes
from app.core.database.migration import (
    is_store,
    presence_of,
    refusal_to_start,
    refuse_newer,
    refuse_unfinished,
)
from app.core.server.tls import ServerCertificate
from app.errors import StoreError, TooCostlyError
from app.line.conditions.catalogue import certificate_expires
from app.line.history.status import DiskReserve, space
from app.people.audit.anchor import anchor_file
from app.people.audit.keys import KeyFileError, find_key_file, owners_of, read_key_file
from app.settings import STORE_FILE, Settings
from app.system.backup.folder import refuse_other_site, space_needed
from app.system.backup.stores import read_key
from app.system.opcua.access import certificate_file
from app.system.opcua.settings import FOLDER
from app.system.state.disk import size_of
from bus.instants import DAY_S, monotonic_now, unix_now
from bus.line.port import why_not
from bus.messages import Message, ParamValue, number
from bus.settings import BusSettings
from bus.tls import (
    Certificate,
    TlsFileError,
    certificate_that_counts,
    date_fault,
    read_certificate,
)

WITHIN_S = 10.0
MAX_EXAMINED_S = 10.0
"""The time for one store; its unexamined part counts as sound if the rest is."""
STEPS = 100_000
"""The steps of SQLite between two checks of the clock."""
MB = 1_000_000


@dataclass(frozen=True, slots=True)
class Finding:
    """A line of the report. A fault keeps Lineside from working as configured; other lines inform."""

    message: Message
    is_fault: bool = False


def info(code: str, /, **params: ParamValue) -> Finding:
    """Return a finding that informs, by the code of its message."""
    return Finding(Message(code, params))


def fault(code: str, /, **params: ParamValue) -> Finding:
    """Return a fault, by the code of its message."""
    return Finding(Message(code, params), is_fault=True)


Check = Callable[[Settings], Iterator[Finding]]


# --- this machine -------------------------------------------------------------------------------------


def user() -> Message:
    """Return the user whose rights hold now: the environment of a changed user still names root."""
    try:
        return Message.of("machine_user", user=pwd.getpwuid(os.geteuid()).pw_name)
    except KeyError:
        return Message.of("machine_user", user=os.geteuid())


def is_visible(path: Path) -> bool:
    """Return whether a path exists in a folder in which this user may look."""
    try:
        return path.exists()
    except OSError:
        return False


def may_make_files_in(folder: Path) -> bool:
    """Return whether this user can make a file in a folder. It is tried and removed at once: root's rights
    allow writing to ``/proc``, which fails."""
    if not os.access(folder, os.W_OK | os.X_OK):
        return False
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"x")
    except OSError:
        return False
    return True


def existing_part(folder: Path) -> Path:
    """Return the folder, or the nearest of its parents that exists."""
    return next(each for each in (folder, *folder.parents) if is_visible(each))


def _is_read_only(path: Path) -> bool:
    return bool(os.statvfs(path).f_flag & os.ST_RDONLY)


def former_settings(settings: Settings) -> Iterator[Finding]:
    """Name settings of earlier versions, which are ignored."""
    yield from map(Finding, settings.former_notices)


def address(settings: Settings) -> Iterator[Finding]:
    """Try to listen at the dashboard's address. A used address is no fault: Lineside may be running."""
    server = settings.server
    place: dict[str, ParamValue] = {"host": server.host, "port": server.port}
    try:
        listen(server.host, server.port, Message("choose_port")).close()
    except PortInUse:
        yield info("check_address_in_use", **place)
    except ListenError as error:
        yield fault("check_server_refused", reason=error.message)
    else:
        yield info("check_address", **place)


def data(settings: Settings) -> Iterator[Finding]:
    """Try whether the folder of the data can have the stores."""
    folder = settings.server.data
    existing = existing_part(folder)
    longest = os.pathconf(existing, "PC_NAME_MAX")
    is_too_long = any(len(os.fsencode(name)) > longest for name in folder.parts)
    if not existing.is_dir():
        yield fault("check_data_is_file", folder=str(existing))
    elif _is_read_only(existing):
        yield fault("check_disk_read_only", path=str(existing))
    elif is_too_long or not may_make_files_in(existing):
        code = "check_data_not_writable" if existing == folder else "check_data_not_creatable"
        yield fault(code, user=user(), folder=str(folder))
    else:
        yield info("check_data" if existing == folder else "check_data_later", folder=str(folder))


def disk(settings: Settings) -> Iterator[Finding]:
    """Check the free space: history stops long before a write of one byte fails."""
    folder = existing_part(settings.server.data)
    free, reserve = shutil.disk_usage(folder).free, DiskReserve()
    match space(free, reserve):
        case "paused":
            full = {"free": free // MB, "reserve": reserve.pause // MB}
            yield fault("check_disk_full", folder=str(folder), **full)
        case "scarce" | "low":
            yield info("check_disk_low", folder=str(folder), free=free // MB)


def service(_: Settings, unit_file: Path = UNIT_FILE) -> Iterator[Finding]:
    """Report each line of the installed unit file, which may have been edited, of which systemd complains: at
    a start systemd mostly ignores such a line."""
    program = shutil.which("systemd-analyze")
    if program is None or not unit_file.is_file():
        return
    try:
        done = subprocess.run(
            [program, "verify", unit_file], capture_output=True, text=True, timeout=WITHIN_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return
    complaints = [line for line in done.stderr.splitlines() if unit_file.name in line]
    for line in complaints:
        yield fault("check_service_refused", complaint=line)
    if not complaints:
        yield info("check_service", file=str(unit_file))


# --- buses --------------------------------------------------------------------------------------------


def buses(settings: Settings) -> Iterator[Finding]:
    """Check the port and the units of each bus."""
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
    yield info(code, bus=bus.name, n=len(bus.unit), port=bus.port, baud=bus.baud)
    if not bus.unit:
        yield info("check_bus_without_units", bus=bus.name, port=bus.port)


def bus_refusal(bus: BusSettings) -> Message | None:
    """Return why a bus's port cannot be used, as far as that shows without opening it."""
    return _url_fault(bus) if "://" in bus.port else _device_fault(bus)


def _device_fault(bus: BusSettings) -> Message | None:
    path, code = bus.port, "check_port_refused"
    try:
        status = Path(path).stat()
    except FileNotFoundError:
        return None
    except OSError as error:
        return Message.of(code, bus=bus.name, reason=why_not(path, error))
    if not stat.S_ISCHR(status.st_mode) or _is_other_device(status.st_rdev):
        number, code = errno.ENOTTY, "check_port_no_device"
    elif not os.access(path, os.R_OK | os.W_OK):
        number = errno.EACCES
    else:
        return None
    return Message.of(code, bus=bus.name, reason=why_not(path, OSError(number, "")))


def _is_other_device(device: int) -> bool:
    """Return whether Linux lists a device as other than a terminal; pseudo-terminals are not listed."""
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


# --- certificates -------------------------------------------------------------------------------------


def encryption(settings: Settings) -> Iterator[Finding]:
    """Try whether the certificate and the key of the server can be used together now."""
    tls = settings.server.tls
    if tls is None:
        if settings.server.is_in_clear:
            yield info("check_no_tls")
        return
    try:
        reason = ServerCertificate(tls).fault
    except TlsFileError as error:
        reason = error.message
    if reason is not None:
        yield fault("check_tls_refused", reason=reason)


CertificateFile = tuple[str, Certificate | None]
"""A file of certificates, and the certificate whose dates count; None if it cannot be read."""


def certificate_files(settings: Settings) -> list[CertificateFile]:
    """Read every file of certificates that the configuration names, the server's own first."""
    tls = settings.server.tls
    authorities = {*settings.notify.certificates, *([tls.client_ca] if tls and tls.client_ca else [])}
    opcua = certificate_file(settings.server.data / FOLDER)
    own = [*([tls.certificate] if tls else []), *([opcua] if settings.opcua and opcua.exists() else [])]
    files = [*((path, min) for path in own), *((path, max) for path in sorted(authorities))]
    return [(str(path), certificate_that_counts(path, which)) for path, which in files]


def certificates(settings: Settings) -> Iterator[Finding]:
    """Report how long each certificate is valid; `encryption` finds faults of the server's own."""
    now, tls = unix_now(), settings.server.tls
    for file, certificate in certificate_files(settings):
        if certificate is None:
            refusal: Message | None = _unreadable(file)
        elif (refusal := date_fault(certificate, Path(file), now)) is None:
            days = int((certificate.ends_at - now) / DAY_S)
            is_soon = certificate_expires(certificate.ends_at, now)
            code = "live_certificate_ends_soon" if is_soon else "live_certificate"
            yield info(code, file=file, n=days, day=certificate.ends_on)
        if refusal is not None and (tls is None or file != str(tls.certificate)):
            yield fault("live_certificate_refused", reason=refusal)


def _unreadable(file: str) -> Message:
    try:
        read_certificate(Path(file))
    except TlsFileError as error:
        return error.message
    return Message.of("tls_no_certificate", file=file)


# --- audit log, stores and backups --------------------------------------------------------------------


def key(settings: Settings) -> Iterator[Finding]:
    """Try whether the key of the audit log can be read, or created at the first start."""
    paths, store = settings.key_files, settings.server.store
    if (found := find_key_file(paths)) is not None:
        try:
            read_key_file(found, owners_of(store if is_visible(store) else None))
        except KeyFileError as error:
            yield fault("check_key_refused", reason=error.message)
        else:
            yield info("check_key", file=str(found))
        return
    *others, last = paths
    writable = next((path for path in others if may_make_files_in(path.parent)), None)
    if writable is not None:
        yield info("check_key_new", file=str(writable))
    elif not others and not may_make_files_in(last.parent):
        yield fault("check_key_not_creatable", user=user(), file=str(last), folder=str(last.parent))
    else:
        yield info("check_key_new_beside_data" if others else "check_key_new", file=str(last))


def anchor(settings: Settings) -> Iterator[Finding]:
    """Try whether the anchor can be written. At the default place a failure is no fault: the start reports
    it."""
    path, is_configured = anchor_file(settings.audit, settings.key_files), settings.audit.anchor is not None
    exists = is_visible(path)
    # Path.is_symlink raises for a name that is too long.
    if os.path.islink(path) or (exists and not path.is_file()):  # noqa: PTH114
        yield fault("check_anchor_no_file", file=str(path))
    elif not (os.access(path, os.W_OK) if exists else may_make_files_in(path.parent)):
        yield Finding(Message.of("check_anchor_not_writable", user=user(), file=str(path)), is_configured)
    else:
        yield info("check_anchor", file=str(path))


def archive(settings: Settings) -> Iterator[Finding]:
    """Try whether events can be archived."""
    if (folder := settings.audit.archive) is None:
        return
    found = _folder_fault(folder, "audit_archive_folder_missing", "check_archive_not_writable")
    yield info("check_archive", folder=str(folder)) if found is None else Finding(found, is_fault=True)


def _folder_fault(folder: Path, missing: str, not_writable: str) -> Message | None:
    """Return why this user cannot write in a folder; ``missing``, ``not_writable``: message codes."""
    if not folder.is_dir():
        return Message.of(missing, folder=str(folder))
    if _is_read_only(folder):
        return Message.of("check_disk_read_only", path=str(folder))
    if not may_make_files_in(folder):
        return Message.of(not_writable, user=user(), folder=str(folder))
    return None


def stores(settings: Settings) -> Iterator[Finding]:
    """Examine each store of the data folder."""
    folder, main = settings.server.data, settings.server.store
    try:
        found = sorted({main, *folder.glob("*.db")}) if existing_part(folder) == folder else [main]
        refusal = refusal_to_start(main, presence_of(main), find_key_file(settings.key_files), new=False)
    except (StoreError, OSError) as error:
        yield _store_refused(error)
        return
    if refusal is not None:
        yield fault("check_store_refused", reason=refusal)
        found.remove(main)
    yield from (_store(store) for store in found if is_visible(store))


def _store(store: Path) -> Finding:
    if _is_read_only(store):
        return fault("check_disk_read_only", path=str(store))
    try:
        with examining(store) as connection:
            end = monotonic_now() + MAX_EXAMINED_S
            connection.set_progress_handler(lambda: monotonic_now() > end, STEPS)
            refuse_unfinished(connection, store)
            if store.name == STORE_FILE and is_store(connection):
                refuse_newer(connection, store)
            (result,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    except TooCostlyError:
        result = "ok"
    except (StoreError, OSError) as error:
        return _store_refused(error)
    if result != "ok":
        return fault("check_store_damaged", path=str(store), verdict=result)
    return info("check_store", path=str(store), size=number(f"{size_of(store) / MB:.1f}"))


def _store_refused(error: StoreError | OSError) -> Finding:
    if isinstance(error, StoreError):
        return fault("check_store_refused", reason=error.message)
    return fault("check_store_refused", reason=Message.of("system_error", error=str(error)))


def backup(settings: Settings) -> Iterator[Finding]:
    """Check the folder of the backups, its disk, and their key."""
    wanted = settings.backup
    if wanted.key_file is not None:
        try:
            read_key(wanted.key_file)
        except StoreError as error:
            yield fault("check_backup_key_refused", reason=error.message)
    if wanted.folder is None:
        return
    folder = str(wanted.folder)
    if (found := backup_folder_fault(settings)) is not None:
        yield Finding(found, is_fault=True)
    elif wanted.every is not None:
        yield info("check_backup_every", folder=folder, every=wanted.every)
    else:
        yield info("check_backup", folder=folder, at=wanted.at)


def backup_folder_fault(settings: Settings) -> Message | None:
    """Return why no backup can be written into the folder of ``[backup]``, if so."""
    folder = settings.backup.folder
    if folder is None:
        return None
    found = _folder_fault(folder, "check_backup_folder_missing", "check_backup_folder_not_writable")
    if found is not None:
        return found
    needed, free = space_needed(settings, folder), free_bytes(folder)
    if needed > free:
        sizes = {"needed": -(-needed // MB), "free": free // MB}
        return Message.of("check_backup_disk_full", folder=str(folder), **sizes)
    if settings.server.store.exists():
        try:
            refuse_other_site(folder, settings.server.store)
        except StoreError as error:
            return error.message
    return None


OF_MACHINE: tuple[Check, ...] = (
    former_settings,
    address,
    encryption,
    data,
    key,
    anchor,
    archive,
    buses,
    certificates,
    disk,
    stores,
    backup,
    service,
)
"""The checks that call no other machine."""
