"""Writes the audit log as 0.2 did: a chain for each bus beside that of the site, as its docs describe them.

Each entry holds the hash of the one before in its chain; the first entry of a bus that of the site, of whose
chain it is the newest entry then, too. The end of each chain is noted and sealed with its name. A new key
seals every chain. A line of the anchor names the ends of all chains; so does a cut of the archive.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from app.core.database import Database, StoreConnection
from app.people.audit.archive import Month, write_file
from app.people.audit.entry import BEGINNING, ROTATED, Head, KeyRing, new_entry, sealed_entry, sealed_head
from app.people.audit.proof import Cut, add_cut

SITE, DRY, WET = "", "dry-end", "wet-end"


@dataclass
class FormerLog:
    """The log of a store. ``ring``: its keys."""

    database: Database
    ring: KeyRing
    ends: dict[str, Head] = field(default_factory=dict)
    number: int = 0

    def record(self, chain: str = SITE, **given: Any) -> int:
        """Add an entry to the chain of a bus, or of the site; return its number."""
        return self.database.write_now(lambda connection: self._add(connection, chain, given))

    def work(self, entries: int = 9) -> None:
        """Entries of one bus, the other and the site by turns."""
        for number in range(entries):
            self.record((DRY, WET, SITE)[number % 3], what=f"e-stop {number}")

    def rotate(self, key: bytes) -> None:
        """Seal every chain with a newer key."""
        self.ring = self.ring.with_key(key)
        for chain in sorted(self.ends):
            self.record(chain, kind="audit", what=ROTATED)

    def anchor_line(self) -> bytes:
        """The ends of all chains as a line of the anchor."""
        newest = max(self.ends.values(), key=lambda head: head.id)
        chains = {chain: [head.id, head.hash] for chain, head in sorted(self.ends.items())}
        line = {"id": newest.id, "hash": newest.hash, "time": "2026-03-01T00:00:00Z", "key": self.ring.newest}
        parts = (str(newest.id), newest.hash, line["time"], json.dumps(chains, separators=(",", ":")))
        seal = self.ring.seal("anchor", *map(str, parts))
        return json.dumps({**line, "seal": seal, "chains": chains}, separators=(",", ":")).encode() + b"\n"

    def archive(self, folder: Path, month: Month) -> None:
        """Move all entries into a file of the archive."""
        rows = self.database.read_now(lambda c: c.execute("SELECT * FROM events ORDER BY id").fetchall())
        name, digest = write_file(folder, month, [[dict(row) for row in rows]])
        heads = {chain: [head.id, head.hash, head.key] for chain, head in sorted(self.ends.items())}
        text = json.dumps(heads, separators=(",", ":"))
        first, last = rows[0]["id"], rows[-1]["id"]
        cut = Cut(last, first, name, digest, rows[0]["hash"], text, 1.0).sealed(self.ring)

        def remove(connection: StoreConnection) -> None:
            add_cut(connection, cut)
            connection.execute("DELETE FROM events WHERE about IS NOT NULL")
            connection.execute("DELETE FROM events")

        self.database.write_now(remove)

    def _add(self, connection: StoreConnection, chain: str, given: Mapping[str, Any]) -> int:
        own = self.ends.get(chain)
        before = own or self.ends.get(SITE, Head(hash=BEGINNING))
        self.number += 1
        entry = new_entry(**{"kind": "estop", "time": 1e9 + self.number, "bus": chain or None, **given})
        row = sealed_entry(before.hash, {**entry, "id": self.number, "chain": chain}, self.ring)
        marks = ", ".join("?" * len(row))
        connection.execute(f"INSERT INTO events ({', '.join(row)}) VALUES ({marks})", [*row.values()])
        for name in {chain} if own else {chain, SITE}:
            head = self.ends[name] = sealed_head(row, self.ring, name)
            connection.execute(
                "INSERT INTO events_head (chain, id, hash, key, seal) VALUES (?, ?, ?, ?, ?) "
                "ON CONFLICT (chain) DO UPDATE "
                "SET id = excluded.id, hash = excluded.hash, key = excluded.key, seal = excluded.seal",
                (name, head.id, head.hash, head.key, head.seal),
            )
        return self.number
