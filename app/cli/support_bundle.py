"""The command ``lineside support-bundle``: data that helps to find a fault from afar, without secrets.

The configuration leaves out secrets; of a configuration that cannot be read only the faults are included,
without its text. Events are without people and values; files are names and sizes; URLs are without user and
password.
"""

from __future__ import annotations

import io
import json
import platform
import subprocess
import sys
import tarfile
import time
from collections.abc import Iterable, Iterator
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import click

from app.cli.command import PATH, config_option, report
from app.cli.findings import OF_MACHINE
from app.cli.install_service import UNIT_FILE
from app.core.database.connection import examining
from app.core.database.files import free_bytes, fresh_file, in_words
from app.errors import StoreError
from app.settings import Settings, load
from app.version import VERSION
from bus.configuration import ConfigurationError
from bus.errors import LinesideError
from bus.messages import Message
from bus.validation import MASK, without_credentials

MAX_EVENTS, MAX_LOG_LINES = 500, 2000
JOURNAL = (
    "journalctl",
    "--unit",
    UNIT_FILE.name,
    "--lines",
    str(MAX_LOG_LINES),
    "--no-pager",
    "--output",
    "short-iso",
)
WITHIN_S = 10.0
WRITTEN = frozenset(("text", "value"))
"""The parameters of a configuration fault that contain text of the configuration."""
_EVENTS = "SELECT id, time, kind, bus, unit, what, outcome FROM events ORDER BY id DESC LIMIT ?"


@click.command
@click.option(
    "--out",
    type=PATH,
    required=True,
    help="The file to write, such as support.tar.gz; it must not exist yet.",
)
@config_option
def support_bundle(out: Path, config: Path) -> None:
    """Write data that helps to find a fault into one file: versions, configuration, findings, events, log. It
    has no password, token, key or value. Nothing else is changed."""
    if out.exists():
        raise StoreError(Message.of("backup_exists", file=str(out)))
    packed = bundle(parts(config))
    with in_words(out), fresh_file(out, packed) as fresh:
        fresh.rename(out)
    report(Message.of("support_bundle_written", file=str(out)))


def parts(config: Path) -> Iterator[tuple[str, bytes]]:
    """Yield each file of the bundle by its name; a part that cannot be read has the reason instead."""
    yield "about.json", _json(_about())
    try:
        settings = load(config)
    except ConfigurationError as error:
        faults = (str(_masked(fault)) for fault in error.faults)
        yield "configuration.txt", "".join(f"{line}\n" for line in dict.fromkeys(faults)).encode()
    else:
        yield "configuration.json", _json(settings.model_dump(mode="json"))
        yield "findings.txt", "".join(f"{line}\n" for line in _found(settings)).encode()
        yield "files.json", _json(_files(settings))
        yield "events.json", _json(_events(settings))
    yield "log.txt", _log()


def bundle(files: Iterable[tuple[str, bytes]]) -> bytes:
    """Pack the files as one archive."""
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz") as archive:
        for name, written in files:
            content = without_credentials(written.decode("utf-8", "surrogateescape")).encode(
                "utf-8", "surrogateescape"
            )
            entry = tarfile.TarInfo(f"lineside-support/{name}")
            entry.size, entry.mode, entry.mtime = len(content), 0o600, int(time.time())
            archive.addfile(entry, io.BytesIO(content))
    return packed.getvalue()


def _masked(fault: Message) -> Message:
    """Return a fault of the configuration without the text that is in the file."""
    params = {
        name: MASK if name in WRITTEN else _masked(value) if isinstance(value, Message) else value
        for name, value in fault.params.items()
    }
    return Message(fault.code, params)


def _about() -> dict[str, Any]:
    return {
        "lineside": VERSION,
        "python": sys.version,
        "system": platform.platform(),
        "time": time.time(),
        "packages": {each.name: each.version for each in sorted(distributions(), key=lambda each: each.name)},
    }


def _found(settings: Settings) -> Iterator[Message]:
    try:
        for finding in (found for row in OF_MACHINE for found in row(settings)):
            yield finding.message
    except (LinesideError, OSError) as error:
        yield Message.of("system_error", error=str(error))


def _files(settings: Settings) -> dict[str, Any]:
    """Return the sizes in bytes of the files below the data folder."""
    data = settings.server.data
    if not data.is_dir():
        return {"folder": str(data), "files": None}
    sizes = {str(path.relative_to(data)): path.stat().st_size for path in data.rglob("*") if path.is_file()}
    return {"folder": str(data), "free": free_bytes(data), "files": sizes}


def _events(settings: Settings) -> list[dict[str, Any]] | str:
    store = settings.server.store
    if not store.exists():
        return "no store in files"
    try:
        with examining(store) as connection:
            rows = connection.execute(_EVENTS, (MAX_EVENTS,)).fetchall()
    except StoreError as error:
        return str(error)
    names = ("id", "time", "kind", "bus", "unit", "what", "outcome")
    return [dict(zip(names, row, strict=True)) for row in rows]


def _log() -> bytes:
    try:
        done = subprocess.run(JOURNAL, capture_output=True, timeout=WITHIN_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{error}\n".encode()
    return done.stdout or done.stderr


def _json(value: Any) -> bytes:
    return json.dumps(value, indent=1, ensure_ascii=False).encode()
