-- Restores that were begun: what each row became outlives the server that wrote it.
CREATE TABLE restore (
    id TEXT PRIMARY KEY,
    bus TEXT NOT NULL,
    unit INTEGER NOT NULL,
    unit_name TEXT NOT NULL,
    who TEXT NOT NULL,
    planned_at REAL NOT NULL,
    equal_rows INTEGER NOT NULL,
    state TEXT NOT NULL,
    cause TEXT NOT NULL
) WITHOUT ROWID;

CREATE INDEX restore_by_unit ON restore (bus, unit, planned_at);

CREATE TABLE restore_row (
    restore_id TEXT NOT NULL REFERENCES restore (id),
    place INTEGER NOT NULL,
    number INTEGER NOT NULL,
    present INTEGER NOT NULL,
    wanted INTEGER NOT NULL,
    outcome TEXT,
    message TEXT NOT NULL,
    read_back INTEGER,
    PRIMARY KEY (restore_id, place)
) WITHOUT ROWID;

CREATE TABLE restore_left_out (
    restore_id TEXT NOT NULL REFERENCES restore (id),
    number INTEGER NOT NULL,
    reason TEXT NOT NULL,
    later INTEGER NOT NULL,
    PRIMARY KEY (restore_id, number)
) WITHOUT ROWID;

-- Every value of the unit: as requested, as it was before, and as the full read afterwards found it.
CREATE TABLE restore_value (
    restore_id TEXT NOT NULL REFERENCES restore (id),
    side TEXT NOT NULL CHECK (side IN ('wanted', 'before', 'proven')),
    number INTEGER NOT NULL,
    raw INTEGER,
    available INTEGER NOT NULL,
    read_at REAL,
    PRIMARY KEY (restore_id, side, number)
) WITHOUT ROWID;
