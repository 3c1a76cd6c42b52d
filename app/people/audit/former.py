"""Logs of versions up to 0.2, which had a chain for each bus beside that of the site. Pure.

The column ``chain`` of an entry tells them apart: NULL in the one chain of today, and of the versions before
there were several; "" in that of the site; else the bus. Numbers ascend over all of them without a gap. The
chain of a bus branches off that of the site: its first entry is an entry of both. The first entry of the one
chain that follows seals the ends of all former ones: its ``previous`` is a hash over them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from app.people.audit.chain import BEGINNING, Head, KeyOrigin, canonical, newest_of
from bus.messages import Message

SITE = ""
"""The chain of the site; and, in what is kept by chain, the only one of today."""
Ends = Mapping[str, Head]
"""The last entry of each chain, by chain."""
JOINED = Message("event_audit_chains_joined")


def joined(ends: Ends) -> str:
    """Return what the entry that continues all chains holds as ``previous``: of one chain the hash of its
    end."""
    if len(ends) > 1:
        plain = {chain: (head.id, head.hash) for chain, head in ends.items()}
        return hashlib.sha256(f"chains\n{canonical(plain)}".encode()).hexdigest()
    return next((head.hash for head in ends.values()), BEGINNING)


def expected_previous(entry: Mapping[str, Any], ends: Ends) -> str:
    """Return the hash that an entry must hold as ``previous`` after chains with these ends."""
    chain = entry.get("chain")
    if chain is None:
        return joined(ends)
    return (ends.get(chain) or ends.get(SITE, Head())).hash


def advance(ends: dict[str, Head], entry: Mapping[str, Any]) -> None:
    """Change the ends of the chains to what they are after an entry."""
    head, chain = Head(entry["id"], entry["hash"], entry.get("key") or ""), entry.get("chain")
    if chain is None:
        ends.clear()
    if chain is None or chain not in ends:
        ends[SITE] = head
    if chain is not None:
        ends[chain] = head


def named(ends: Ends) -> list[Message]:
    """Return where each chain ended, for people: part of the entry that continues them."""
    return [
        Message.of("audit_chain_ended", bus=chain, entry=head.id, hash=head.hash)
        if chain
        else Message.of("audit_chain_of_site_ended", entry=head.id, hash=head.hash)
        for chain, head in sorted(ends.items())
    ]


def origin_of(heads: Ends) -> KeyOrigin:
    """Return the ends of the chains as those before a first key that is made now."""
    newest = newest_of(heads.values())
    others: Sequence[tuple[str, int, str]] = [
        (name, head.id, head.hash) for name, head in sorted(heads.items()) if head is not newest
    ]
    return KeyOrigin(newest.id, newest.hash, tuple(others))
