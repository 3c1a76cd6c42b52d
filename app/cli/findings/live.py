"""What ``lineside check --live`` finds: what the configuration names is tried. Every trial is undone, nothing
is sent, and a running Lineside is left alone."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from app.audit.anchor import anchor_file
from app.cli.findings.machine import Finding, fault, is_visible, may_make_files_in, user
from app.cli.findings.ports import PortUsers, port_findings
from app.cli.serving.listening import ListenError, PortInUse, listen, url_of
from app.cli.site.status import is_serving, verification
from app.cli.site.status_lines import GB
from app.database.connection import examining
from app.database.migration import refuse_newer
from app.database.presence import presence_of
from app.database.reserve import free_bytes
from app.errors import StoreError
from app.settings import LOCK_FILE, ServerSettings, Settings
from bus.messages import Message, ParamValue, number

_LOCKS = Path("/proc/locks")


def live_findings(settings: Settings, users: PortUsers) -> Iterator[Finding]:
    """Everything that can be tried, in the order of the file. ``users``: the programs at the serial ports."""
    serves = _serves(settings.server)
    has_lock = is_locked(settings.server.data / LOCK_FILE)
    yield Finding(Message.of("live_user", user=user()))
    yield from _address(settings.server, has_lock=has_lock, serves=serves)
    yield from _folders(settings)
    yield from _store(settings)
    yield from port_findings(settings, users, server_runs=bool(has_lock) or serves)


def is_locked(file: Path) -> bool | None:
    """Whether a process has a lock on the file; None where this user cannot see that. It is looked up: to try
    it would keep a server from it."""
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
        yield Finding(Message.of("live_address_own", url=_url(server)))
    elif server.port:
        try:
            listen(server.host, server.port, Message("choose_port")).close()
        except PortInUse as error:
            stalled = fault("live_address_stalled", **place, folder=str(server.data))
            yield stalled if has_lock else fault("check_server_refused", reason=error.message)
        except ListenError:
            return  # `lineside check` has the reason already
        else:
            yield Finding(Message("live_address_free", place))


def _folders(settings: Settings) -> Iterator[Finding]:
    """Those in which a running server writes, where `lineside check` has found no fault in them."""
    data = settings.server.data
    inner = sorted(_entries(data))
    folders = [data, *(each for each in inner if each.is_dir() and not each.is_symlink())]
    for folder in dict.fromkeys((*folders, settings.backup.folder, anchor_file(settings).parent)):
        if folder is not None and is_visible(folder) and may_make_files_in(folder):
            free = number(f"{free_bytes(folder) / GB:.1f}")
            yield Finding(Message.of("live_folder", folder=str(folder), user=user(), free=free))
    for path in inner:
        if not os.access(path, os.R_OK | os.W_OK):
            yield fault("live_file_not_writable", user=user(), path=str(path), folder=str(data))


def _entries(data: Path) -> Iterator[Path]:
    """All below a folder, as far as this user may look."""
    for folder, folders, files in os.walk(data):
        yield from (Path(folder, name) for name in (*folders, *files))


def _store(settings: Settings) -> Iterator[Finding]:
    """Whether the tables of the main store are those of this version."""
    store = settings.server.store
    try:
        if presence_of(store) != "sound":
            return
        with examining(store) as connection:
            steps = refuse_newer(connection, store)
    except StoreError:
        return  # `lineside check` has the reason already
    yield Finding(Message.of("live_store_earlier" if steps else "live_store", path=str(store), n=len(steps)))
