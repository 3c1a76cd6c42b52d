-- Notes of a shift, pinned to a moment. A note is never changed: a correction is a new one that names it.
CREATE TABLE shift_note (
    id         INTEGER PRIMARY KEY AUTOINCREMENT,
    at         REAL    NOT NULL,
    written_at REAL    NOT NULL,
    who        TEXT    NOT NULL,
    text       TEXT    NOT NULL,
    bus        TEXT,
    unit       INTEGER,
    alarm      TEXT,
    corrects   INTEGER UNIQUE REFERENCES shift_note (id),
    sender     TEXT    NOT NULL,
    key        TEXT,
    UNIQUE (sender, key)
) STRICT;
CREATE INDEX shift_note_by_time ON shift_note (at);

CREATE TRIGGER shift_note_stays_as_written BEFORE UPDATE ON shift_note
BEGIN SELECT RAISE(ABORT, 'a note is never changed'); END;
CREATE TRIGGER shift_note_stays BEFORE DELETE ON shift_note
BEGIN SELECT RAISE(ABORT, 'a note is never removed'); END;
