"""Proof of archived events: each file continues the one before it, and the store the last one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from app.audit.archive.cut import Cut
from app.audit.archive.file import EventArchiveError, digest_of, entries_in
from app.audit.proof.chain import Head
from app.audit.proof.keyring import KeyRing
from app.audit.proof.walk import Walk
from bus.messages import Message

CHUNK = 500


@dataclass(frozen=True, slots=True)
class ArchiveProof:
    """So many archived ``entries`` are proven. The files that are ``absent`` were not looked at."""

    entries: int = 0
    absent: tuple[str, ...] = ()


def prove_archive(
    cuts: Sequence[Cut], folder: Path | None, ring: KeyRing, anchors: Mapping[int, Head]
) -> ArchiveProof:
    """Verify the files of all cuts that are in a folder. Raises EventArchiveError at the first that is not as
    it was written, OSError for one that cannot be read."""
    entries, absent = 0, []
    start: Mapping[str, Head] | None = None
    expected = cuts[0].first if cuts else 0
    for cut in cuts:
        if not cut.is_sealed(ring) or cut.first != expected:
            raise EventArchiveError(Message.of("audit_archive_forged", file=cut.file))
        path = folder / cut.file if folder else None
        if path is None or not path.exists():
            absent.append(cut.file)
        else:
            _prove_file(path, cut, Walk(ring, _within(cut, anchors), start))
            entries += cut.last - cut.first + 1
        start, expected = cut.ends, cut.last + 1
    return ArchiveProof(entries, tuple(absent))


def _prove_file(path: Path, cut: Cut, walk: Walk) -> None:
    entries = entries_in(path)
    while chunk := [*islice(entries, CHUNK)]:
        walk.follow(chunk)
        if walk.fault is not None:
            raise EventArchiveError(Message.of("audit_archive_altered_at", file=cut.file, reason=walk.fault))
    if digest_of(path) != cut.digest or _plain(walk.ends) != _plain(cut.ends):
        raise EventArchiveError(Message.of("audit_archive_altered", file=cut.file))


def _within(cut: Cut, anchors: Mapping[int, Head]) -> dict[int, Head]:
    return {number: head for number, head in anchors.items() if cut.first <= number <= cut.last}


def _plain(ends: Mapping[str, Head]) -> set[tuple[str, int, str]]:
    return {(chain, head.id, head.hash) for chain, head in ends.items()}
