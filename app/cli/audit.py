"""The command ``lineside audit``: proof that no event log entry was changed or removed; new keys."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import click

from app.cli.command import PATH, config_option, json_option, report
from app.cli.site import has_store, reading_site, record, site_log
from app.cli.starting import check_store
from app.core.database.connection import examining
from app.core.database.files import in_words
from app.core.web.shape import message_shown
from app.errors import StoreError
from app.people.audit.anchor import Anchors, anchor_file, read_anchor_file
from app.people.audit.archive import ArchiveProof, prove_archive
from app.people.audit.entry import ROTATED, Ends, KeyRing, newest_of, origin_of
from app.people.audit.keys import find_key_file, owners_of, read_key_file
from app.people.audit.proof import AuditVerification, cuts_of, heads_of, prove
from app.records.handover.signatures import missing_signatures
from app.settings import Settings, load
from app.system.postgresql.destination import Destination, compare
from app.system.postgresql.outbox import read_identity
from bus.errors import CallerError
from bus.messages import Message, in_english


@click.group
def audit() -> None:
    """Verify the event log, or begin a new key."""


@audit.command("verify")
@config_option
@click.option(
    "--anchor",
    type=PATH,
    help="The file with its anchors; without it, the one of the configuration or beside the key.",
)
@click.option(
    "--archive", type=PATH, help="The folder with archived events; without it, the one of the configuration."
)
@click.option("--postgresql", is_flag=True, help="Compare it with the events in the plant's database, too.")
@json_option
def verify(config: Path, anchor: Path | None, archive: Path | None, postgresql: bool, as_json: bool) -> None:
    """Verify every entry of the log, its seals and anchors, the archived events, and that the store has the
    signatures of shifts that the log names. Exit 0 when all is intact, 1 with the first altered entry."""
    settings = load(config)
    proof = proof_of(settings, anchor, archive)
    if postgresql:
        proof += _compared(settings, config)
    if as_json:
        click.echo(json.dumps({"intact": True, "messages": [message_shown(line) for line in proof]}))
        return
    for line in proof:
        report(line)


@audit.command("rotate-key")
@config_option
def rotate_key(config: Path) -> None:
    """Seal new entries with a new key, also while the dashboard runs. Older keys stay in the file: they
    verify the entries that they sealed."""
    with site_log(load(config)) as (_, events):
        events.keys.rotate()
        # This entry has the new key: from now on, a log that ends before it is known to be cut off.
        record(events, "audit", ROTATED)
    report(Message.of("key_rotated", file=str(events.keys.path)))


def proof_of(settings: Settings, anchor: Path | None = None, archive: Path | None = None) -> list[Message]:
    """Verify the log of a site; return the proven facts. Raise StoreError if it is not intact."""
    proof, anchors, archived = _proof(settings, anchor, archive or settings.audit.archive)
    if proof.broken is not None:
        fault = in_english(proof.fault)
        raise StoreError(Message.of("audit_broken", entry=proof.broken, fault=fault))
    return [Message.of("audit_whole", n=proof.entries), *_remarks(proof, anchors, archived)]


def _compared(settings: Settings, config: Path) -> list[Message]:
    """Compare the log with the plant's database. Raise StoreError if they differ."""
    if settings.postgresql is None:
        raise CallerError(Message.of("publish_not_configured", config=str(config)))
    with reading_site(settings) as connection:
        place, identity = settings.postgresql.place, read_identity(connection)
        destination = Destination(settings.postgresql, settings.site.name, identity, settings.bus)
        try:
            found = compare(connection, destination)
        finally:
            destination.abandon()
    remarks = [Message.of("audit_witness_agrees", n=found.same, place=place)]
    if found.replaced:
        remarks.append(Message.of("audit_witness_replaced", n=found.replaced))
    if found.unpublished:
        remarks.append(Message.of("audit_witness_unpublished", n=found.unpublished))
    return remarks


def _proof(
    settings: Settings, anchor: Path | None, archive: Path | None
) -> tuple[AuditVerification, Anchors, ArchiveProof]:
    """Verify the files as they are, without migrating or writing any."""
    check_store(settings)
    if not has_store(settings):
        raise StoreError(Message.of("store_missing", path=str(settings.server.store)))
    with examining(settings.server.store) as connection:
        ring = _ring(settings.key_files, settings.server.store, heads_of(connection))
        anchors = _anchors(settings, anchor, ring)
        proof = prove(connection, ring, anchors.hashes)
        if proof.broken is None:
            for each in missing_signatures(connection):
                raise StoreError(
                    Message.of("audit_signature_missing", entry=each.event, who=each.who, start=each.start)
                )
        with in_words(archive or settings.server.data):
            archived = prove_archive(cuts_of(connection), archive, ring, anchors.hashes)
        return proof, anchors, archived


def _anchors(settings: Settings, named: Path | None, ring: KeyRing) -> Anchors:
    """Read the anchors of the named or configured file, else of the file beside the key if it exists."""
    path = named or anchor_file(settings.audit, settings.key_files)
    if path not in (named, settings.audit.anchor) and not path.exists():
        return Anchors()
    return read_anchor_file(path, ring)


def _ring(paths: Sequence[Path], store: Path | None, heads: Ends) -> KeyRing:
    path = find_key_file(paths)
    ring = read_key_file(path, owners_of(store)) if path else None
    if ring is None and newest_of(heads.values()).key:
        raise StoreError(Message.of("audit_key_missing", path=str(paths[0])))
    return ring or KeyRing((), origin_of(heads))


def _remarks(proof: AuditVerification, anchors: Anchors, archived: ArchiveProof) -> list[Message]:
    """Return remarks on what the proof covers besides the store, and on what it leaves out."""
    remarks = []
    if archived.entries:
        remarks.append(Message.of("audit_archive_intact", n=archived.entries))
    if archived.absent:
        remarks.append(Message.of("audit_archive_absent", files=", ".join(archived.absent)))
    if proof.unsealed:
        remarks.append(Message.of("audit_unsealed", last=proof.unsealed))
    if anchors.hashes:
        remarks.append(Message.of("anchors_hold", n=len(anchors.hashes), newest=proof.anchored))
    if anchors.unreadable:
        remarks.append(Message.of("anchor_lines_unreadable", n=anchors.unreadable))
    return remarks
