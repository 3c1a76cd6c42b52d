-- Times are µs since the epoch, values as on the wire. A bus has a row too, number 0.
CREATE TABLE unit (
    id INTEGER PRIMARY KEY,
    bus TEXT NOT NULL,
    number INTEGER NOT NULL,
    UNIQUE (bus, number)
) STRICT;

-- Readings of minutes that are not over, of all units, as they came: one row for each commit.
CREATE TABLE journal (
    seq INTEGER PRIMARY KEY,
    data BLOB NOT NULL
) STRICT;

-- Runs of one unit over one minute, or one hour once that is over.
CREATE TABLE raw (
    id INTEGER PRIMARY KEY,
    unit INTEGER NOT NULL REFERENCES unit (id),
    start INTEGER NOT NULL,
    span INTEGER NOT NULL,
    points INTEGER NOT NULL,
    data BLOB NOT NULL
) STRICT;
CREATE UNIQUE INDEX raw_by_unit ON raw (unit, start, span, points);
CREATE INDEX raw_by_time ON raw (start);
CREATE INDEX raw_to_compact ON raw (start, unit) WHERE span = 60000000;

-- One-minute rollups, an hour in a row; one-hour rollups, a day in a row.
CREATE TABLE minutes (
    unit INTEGER NOT NULL REFERENCES unit (id),
    start INTEGER NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (unit, start)
) STRICT, WITHOUT ROWID;
CREATE TABLE hours (
    unit INTEGER NOT NULL REFERENCES unit (id),
    start INTEGER NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (unit, start)
) STRICT, WITHOUT ROWID;

-- Output and input bits (ST2 × 256 + ST1) from the first reading that has them to the last.
CREATE TABLE bits (
    unit INTEGER NOT NULL REFERENCES unit (id),
    at INTEGER NOT NULL,
    word INTEGER NOT NULL,
    until INTEGER NOT NULL,
    PRIMARY KEY (unit, at, word)
) STRICT, WITHOUT ROWID;

-- The state of a unit, or of a bus's port: online, stale, offline, unknown, open, closed.
CREATE TABLE link (
    unit INTEGER NOT NULL REFERENCES unit (id),
    at INTEGER NOT NULL,
    state TEXT NOT NULL,
    cause TEXT NOT NULL,
    PRIMARY KEY (unit, at, state)
) STRICT, WITHOUT ROWID;

-- The parameters that scale a reading, each from when it was first read with this value.
CREATE TABLE parameter (
    unit INTEGER NOT NULL REFERENCES unit (id),
    number INTEGER NOT NULL,
    at INTEGER NOT NULL,
    raw INTEGER NOT NULL,
    PRIMARY KEY (unit, number, at)
) STRICT, WITHOUT ROWID;

-- 'raw_from': readings before this time were given up, to age or to a full disk.
CREATE TABLE fact (
    name TEXT PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
