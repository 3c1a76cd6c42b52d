"""``lineside audit``: proof that no entry of the event log was changed, removed or cut off; a newer key."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from app.audit.anchor import Anchors, read_anchor_file
from app.audit.chain import Head
from app.audit.keyring import KeyOrigin, KeyRing
from app.audit.keys import find_key_file, open_keys, owners_of, read_key_file
from app.audit.log import EventLog
from app.audit.store import head_of, prove
from app.audit.walk import Verdict
from app.cli.accounts import ORIGIN, who_calls
from app.cli.check_store import check_store
from app.cli.ending import ending, report
from app.cli.serve import LINESIDE_TOML, Config
from app.database import Database
from app.database.connection import open_for_reading
from app.database.private import make_private
from app.database.words import in_words
from app.errors import StoreError
from app.settings import Settings, load
from bus.messages import Message, in_english

audit = typer.Typer(help="Verify the event log, or begin a new key.", no_args_is_help=True)
AnchorFile = Annotated[
    Path | None, typer.Option(help="The file with its anchors; without it, the one of the configuration.")
]


@audit.command()
def verify(config: Config = LINESIDE_TOML, anchor: AnchorFile = None) -> None:
    """Verify chain, seals and anchors of the log. Exit 0 when it is intact, 1 with the first altered entry.
    Without an anchor, the replacement of the store by an earlier copy cannot be detected."""
    with ending():
        settings = load(config)
        verdict, anchors = _verdict(settings, anchor or settings.audit.anchor)
        if verdict.broken is not None:
            fault = in_english(verdict.fault)
            raise StoreError(Message.of("audit_broken", entry=verdict.broken, fault=fault))
    report(Message.of("audit_whole", n=verdict.entries))
    for remark in _remarks(verdict, anchors):
        report(remark)


@audit.command(name="rotate-key")
def rotate_key(config: Config = LINESIDE_TOML) -> None:
    """Seal new entries with a new key, also while the dashboard runs. The older keys stay in the file: they
    verify the entries that they sealed."""
    with ending():
        settings = load(config)
        check_store(settings)
        make_private(settings.server.data)
        database = Database(settings.server.store, checkpoints=False)
        try:
            path = asyncio.run(_rotate(database, settings))
        finally:
            database.close()
    report(Message.of("key_rotated", file=str(path)))


async def _rotate(database: Database, settings: Settings) -> Path | None:
    keys = open_keys(settings.key_files, database.path, await database.read(head_of))
    keys.rotate()
    # Sealed with the newer key: from here on a log that ends before it is seen to have been cut off.
    await EventLog(database, keys=keys).record(
        kind="audit", what=Message("event_audit_key_rotated"), who=who_calls(), origin=ORIGIN
    )
    return keys.path


def _verdict(settings: Settings, anchor: Path | None) -> tuple[Verdict, Anchors]:
    """From the files as they are: nothing is brought up to date, nothing is written."""
    store = settings.server.store
    if not store.exists():
        raise StoreError(Message.of("store_missing", path=str(store)))
    with in_words(store), closing(open_for_reading(store)) as connection:
        ring = _ring(settings.key_files, store, head_of(connection))
        anchors = read_anchor_file(anchor, ring) if anchor else Anchors()
        if anchors.forged is not None:
            raise StoreError(Message.of("anchor_line_forged", line=anchors.forged, path=str(anchor)))
        return prove(connection, ring, anchors.heads), anchors


def _ring(paths: Sequence[Path], store: Path, head: Head) -> KeyRing:
    path = find_key_file(paths)
    ring = read_key_file(path, owners_of(store)) if path else None
    if ring is None and head.key:
        raise StoreError(Message.of("audit_key_missing", path=str(paths[0])))
    return ring or KeyRing((), KeyOrigin(head.id, head.hash))


def _remarks(verdict: Verdict, anchors: Anchors) -> list[Message]:
    """What the proof does not cover."""
    remarks = []
    if verdict.unsealed:
        remarks.append(Message.of("audit_unsealed", last=verdict.unsealed))
    if anchors.heads:
        remarks.append(Message.of("anchors_hold", n=len(anchors.heads), newest=verdict.anchored))
    if anchors.unreadable:
        remarks.append(Message.of("anchor_lines_unreadable", n=anchors.unreadable))
    return remarks
