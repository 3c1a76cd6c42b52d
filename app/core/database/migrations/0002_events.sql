-- Who did what. Each entry holds the hash of the one before; an entry is never changed or removed.
-- The outcome of a command is a separate entry, with the id of the command in `about`.
CREATE TABLE events (
    id       INTEGER PRIMARY KEY,
    time     REAL    NOT NULL,
    kind     TEXT    NOT NULL,
    about    INTEGER REFERENCES events (id),
    who      TEXT    NOT NULL,
    origin   TEXT    NOT NULL,
    bus      TEXT,
    unit     INTEGER,
    what     TEXT    NOT NULL,
    old      TEXT,
    new      TEXT,
    old_raw  INTEGER,
    new_raw  INTEGER,
    outcome  TEXT,
    message  TEXT    NOT NULL,
    frames   TEXT    NOT NULL,
    previous TEXT    NOT NULL,
    hash     TEXT    NOT NULL
) STRICT;
CREATE UNIQUE INDEX events_by_about ON events (about) WHERE about IS NOT NULL;
CREATE INDEX events_by_kind ON events (kind, id) WHERE about IS NULL;
CREATE INDEX events_by_unit ON events (bus, unit, id) WHERE about IS NULL;
CREATE INDEX events_by_time ON events (time) WHERE about IS NULL;

CREATE TRIGGER events_stay_as_written BEFORE UPDATE ON events
BEGIN SELECT RAISE(ABORT, 'an event is never changed'); END;
CREATE TRIGGER events_stay BEFORE DELETE ON events
BEGIN SELECT RAISE(ABORT, 'an event is never removed'); END;

-- The newest entry, kept apart so that a log cut off at its end is noticed.
CREATE TABLE events_head (
    only INTEGER PRIMARY KEY CHECK (only = 1),
    id   INTEGER NOT NULL,
    hash TEXT    NOT NULL
) STRICT;
CREATE TRIGGER events_head_goes_forward BEFORE UPDATE ON events_head WHEN NEW.id <= OLD.id
BEGIN SELECT RAISE(ABORT, 'the head of the log only goes forward'); END;
CREATE TRIGGER events_head_stays BEFORE DELETE ON events_head
BEGIN SELECT RAISE(ABORT, 'the head of the log is never removed'); END;
