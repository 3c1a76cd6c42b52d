-- What an engineer allows for the speed of a unit; NULL: no limit. Raw integers as on the wire.
CREATE TABLE limits (
    bus          TEXT    NOT NULL,
    unit         INTEGER NOT NULL,
    lowest       INTEGER,
    highest      INTEGER,
    largest_step INTEGER,
    per_minute   INTEGER,
    set_by       TEXT    NOT NULL,
    set_at       REAL    NOT NULL,
    PRIMARY KEY (bus, unit)
) STRICT, WITHOUT ROWID;

-- Units that must not be commanded, and why.
CREATE TABLE blocks (
    bus    TEXT    NOT NULL,
    unit   INTEGER NOT NULL,
    reason TEXT    NOT NULL,
    set_by TEXT    NOT NULL,
    set_at REAL    NOT NULL,
    PRIMARY KEY (bus, unit)
) STRICT, WITHOUT ROWID;
