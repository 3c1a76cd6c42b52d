"""``lineside audit``: proof that no entry of the event log was changed, removed or cut off; a newer key."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import click

from app.audit.archive.cuts import cuts_of
from app.audit.archive.proof import ArchiveProof, prove_archive
from app.audit.events.store import heads_of, prove
from app.audit.proof.anchor import Anchors, joined_heads, read_anchor_file, read_key_anchor, refuse_forged
from app.audit.proof.chain import ROTATED, Head, newest_of, origin_of
from app.audit.proof.keyring import KeyRing
from app.audit.proof.keys import find_key_file, owners_of, read_key_file
from app.audit.proof.walk import AuditVerification, ChainVerification
from app.cli.config_option import LINESIDE_TOML, Config
from app.cli.ending import report
from app.cli.options import AsJson, CommandGroup, Option
from app.cli.serving.serve import check_store
from app.cli.site.log import record, site_log
from app.cli.site.reading import has_store
from app.database.connection import examining
from app.database.words import in_words
from app.errors import StoreError
from app.handover.signing.signatures import missing_signatures
from app.settings import Settings, load
from app.web.api.shape import message_shown
from bus.messages import Message, in_english, joined

audit = CommandGroup(help="Verify the event log, or begin a new key.")
AnchorFile = Annotated[
    Path | None, Option(help="The file with its anchors; without it, the one of the configuration.")
]
ArchiveFolder = Annotated[
    Path | None, Option(help="The folder with archived events; without it, the one of the configuration.")
]


@audit.add("verify")
def verify(
    config: Config = LINESIDE_TOML,
    anchor: AnchorFile = None,
    archive: ArchiveFolder = None,
    as_json: AsJson = False,
) -> None:
    """Verify every chain of the log, its seals and anchors, the archived events, and that the store has the
    signatures of shifts that the log names. Exit 0 when all is intact, 1 with the first altered entry of each
    chain."""
    proof = proof_of(load(config), anchor, archive)
    if as_json:
        click.echo(json.dumps({"intact": True, "messages": [message_shown(line) for line in proof]}))
        return
    for line in proof:
        report(line)


@audit.add("rotate-key")
def rotate_key(config: Config = LINESIDE_TOML) -> None:
    """Seal new entries with a new key, also while the dashboard runs. The older keys stay in the file: they
    verify the entries that they sealed."""
    with site_log(load(config)) as (_, events):
        events.keys.rotate()
        # Sealed with the newer key: from here on a log that ends before it is seen to have been cut off.
        record(events, "audit", ROTATED)
    report(Message.of("key_rotated", file=str(events.keys.path)))


def proof_of(settings: Settings, anchor: Path | None = None, archive: Path | None = None) -> list[Message]:
    """Verify the log of a store; gives how much of it is proven. Raises StoreError where it is not intact."""
    verdict, anchors, archived = _verdict(settings, anchor, archive or settings.audit.archive)
    if broken := joined([_broken(chain) for chain in verdict.chains if chain.fault is not None]):
        raise StoreError(broken)
    return [Message.of("audit_whole", n=verdict.entries), *_remarks(verdict, anchors, archived)]


def _verdict(
    settings: Settings, anchor: Path | None, archive: Path | None
) -> tuple[AuditVerification, Anchors, ArchiveProof]:
    """Verify the files as they are: nothing is migrated, nothing is written."""
    check_store(settings)
    file = settings.server.store
    if not has_store(settings):
        raise StoreError(Message.of("store_missing", path=str(settings.server.store)))
    with examining(settings.server.store) as connection:
        ring = _ring(settings.key_files, file, heads_of(connection))
        anchors = _anchors(settings, anchor, ring)
        beside_key = read_key_anchor(find_key_file(settings.key_files), ring)
        heads = joined_heads(anchors, beside_key)
        verdict = prove(connection, ring, heads)
        if verdict.broken is None:
            for each in missing_signatures(connection):
                raise StoreError(
                    Message.of("audit_signature_missing", entry=each.event, who=each.who, start=each.start)
                )
        with in_words(archive or settings.server.data):
            archived = prove_archive(cuts_of(connection), archive, ring, heads)
        return verdict, anchors, archived


def _broken(chain: ChainVerification) -> Message:
    entry, fault = chain.broken or 0, in_english(chain.fault)
    if chain.bus is None:
        return Message.of("audit_broken", entry=entry, fault=fault)
    return Message.of("audit_broken_of_bus", bus=chain.bus, entry=entry, fault=fault)


def _anchors(settings: Settings, named: Path | None, ring: KeyRing) -> Anchors:
    """Read the anchors of the file that was named or configured, or of the default place where it exists."""
    path = named or settings.anchor_file
    if path not in (named, settings.audit.anchor) and not path.exists():
        return Anchors()
    return refuse_forged(path, read_anchor_file(path, ring))


def _ring(paths: Sequence[Path], store: Path | None, heads: Mapping[str, Head]) -> KeyRing:
    path = find_key_file(paths)
    ring = read_key_file(path, owners_of(store)) if path else None
    if ring is None and newest_of(heads.values()).key:
        raise StoreError(Message.of("audit_key_missing", path=str(paths[0])))
    return ring or KeyRing((), origin_of(heads))


def _remarks(verdict: AuditVerification, anchors: Anchors, archived: ArchiveProof) -> list[Message]:
    """List the chains, and what the proof does not cover."""
    remarks = []
    if buses := [chain.bus for chain in verdict.chains if chain.bus is not None]:
        remarks.append(Message.of("audit_chains", buses=buses))
    if archived.entries:
        remarks.append(Message.of("audit_archive_intact", n=archived.entries))
    if archived.absent:
        remarks.append(Message.of("audit_archive_absent", files=", ".join(archived.absent)))
    if verdict.unsealed:
        remarks.append(Message.of("audit_unsealed", last=verdict.unsealed))
    if anchors.heads:
        remarks.append(Message.of("anchors_hold", n=len(anchors.heads), newest=verdict.anchored))
    if anchors.unreadable:
        remarks.append(Message.of("anchor_lines_unreadable", n=anchors.unreadable))
    return remarks
