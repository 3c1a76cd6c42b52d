"""A full-text index over the events, so that a search does not read all of them.

It finds what ``LIKE '%text%'`` finds for three characters and more (the trigram tokenizer of FTS5), and
`app.audit.store` still checks each hit by LIKE. What the index does not cover yet, and every search on a
SQLite without FTS5, is read row by row. The index is apart from the chain: it can be dropped and built again.
"""

from __future__ import annotations

import sqlite3

SHORTEST = 3
"""Characters of a trigram."""
MAX_AT_ONCE = 200
"""Rows that are indexed in one transaction: some milliseconds, for which commands wait."""
_COLUMNS = "what, who, old, new, message"
_NEW_COLUMNS = "NEW.what, NEW.who, NEW.old, NEW.new, NEW.message"
_TRIGGER = "events_text_follows"
_CREATE = f"""
DROP TABLE IF EXISTS events_text;
CREATE VIRTUAL TABLE events_text USING fts5 (
    {_COLUMNS}, content = 'events', content_rowid = 'id', tokenize = 'trigram', columnsize = 0
);
CREATE TABLE IF NOT EXISTS events_text_extent (
    only   INTEGER PRIMARY KEY CHECK (only = 1),
    lowest INTEGER NOT NULL
);
INSERT OR REPLACE INTO events_text_extent SELECT 1, COALESCE(max(id), 0) + 1 FROM events;
CREATE TRIGGER {_TRIGGER} AFTER INSERT ON events BEGIN
    INSERT INTO events_text (rowid, {_COLUMNS}) VALUES (NEW.id, {_NEW_COLUMNS});
END;
"""
MATCHING = """
SELECT COALESCE(entry.about, entry.id) FROM events_text JOIN events entry ON entry.id = events_text.rowid
WHERE events_text MATCH ?
"""
"""The events that are found, each also by the entry of its result."""


def prepare(connection: sqlite3.Connection) -> None:
    """Build the index where there is none. Where FTS5 is missing, remove its tables: each event is written
    as before, and the index is rebuilt when FTS5 is back."""
    if not is_possible(connection):
        connection.execute(f"DROP TRIGGER IF EXISTS {_TRIGGER}")
    elif not _follows(connection):
        for statement in _statements(_CREATE):
            connection.execute(statement)


def index_more(connection: sqlite3.Connection) -> bool:
    """Index the newest events that are not yet; whether there are more."""
    lowest = lowest_indexed(connection)
    if lowest is None:
        return False
    step = max(lowest - MAX_AT_ONCE, 1)
    query = f"SELECT id, {_COLUMNS} FROM events WHERE id >= ? AND id < ?"
    connection.execute(f"INSERT INTO events_text (rowid, {_COLUMNS}) {query}", (step, lowest))
    connection.execute("UPDATE events_text_extent SET lowest = ?", (step,))
    return step > 1


def lowest_indexed(connection: sqlite3.Connection) -> int | None:
    """From which event on all are in the index; None without an index."""
    if not _follows(connection):
        return None
    lowest: int = connection.execute("SELECT lowest FROM events_text_extent").fetchone()[0]
    return lowest


def phrase(text: str) -> str:
    """The text as a string of FTS5; empty for one that the index cannot find."""
    if len(text) < SHORTEST or "\0" in text:
        return ""
    return '"' + text.replace('"', '""') + '"'


def is_possible(connection: sqlite3.Connection) -> bool:
    """Whether this SQLite has FTS5 with trigrams (from 3.34 on)."""
    found = connection.execute("SELECT 1 FROM pragma_module_list WHERE name = 'fts5'").fetchone()
    return found is not None and sqlite3.sqlite_version_info >= (3, 34)


def _follows(connection: sqlite3.Connection) -> bool:
    """New events are indexed, so none is missing above the lowest."""
    query = "SELECT 1 FROM sqlite_master WHERE type = 'trigger' AND name = ?"
    return connection.execute(query, (_TRIGGER,)).fetchone() is not None


def _statements(script: str) -> list[str]:
    """``executescript`` would end the transaction."""
    found, begun = [], ""
    for line in script.splitlines():
        begun += line + "\n"
        if sqlite3.complete_statement(begun):
            found.append(begun)
            begun = ""
    return found
