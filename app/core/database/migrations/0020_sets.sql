-- Parameter sets: immutable once stored; only their golden mark moves.
CREATE TABLE parameter_set (
    id INTEGER PRIMARY KEY,
    bus TEXT NOT NULL,
    name TEXT NOT NULL,
    comment TEXT NOT NULL,
    taken_at REAL NOT NULL,
    who TEXT NOT NULL,
    origin TEXT NOT NULL
);

CREATE TABLE parameter_set_unit (
    set_id INTEGER NOT NULL REFERENCES parameter_set (id),
    unit INTEGER NOT NULL,
    name TEXT NOT NULL,
    PRIMARY KEY (set_id, unit)
) WITHOUT ROWID;

CREATE TABLE parameter_set_row (
    set_id INTEGER NOT NULL REFERENCES parameter_set (id),
    unit INTEGER NOT NULL,
    number INTEGER NOT NULL,
    raw INTEGER,
    available INTEGER NOT NULL,
    read_at REAL,
    frame BLOB NOT NULL,
    PRIMARY KEY (set_id, unit, number)
) WITHOUT ROWID;

CREATE INDEX parameter_set_by_unit ON parameter_set_unit (unit, set_id);

CREATE TRIGGER parameter_set_is_immutable BEFORE UPDATE ON parameter_set
BEGIN SELECT RAISE(ABORT, 'a stored parameter set does not change'); END;
CREATE TRIGGER parameter_set_row_is_immutable BEFORE UPDATE ON parameter_set_row
BEGIN SELECT RAISE(ABORT, 'a stored parameter set does not change'); END;
CREATE TRIGGER parameter_set_row_stays BEFORE DELETE ON parameter_set_row
BEGIN SELECT RAISE(ABORT, 'a stored parameter set does not change'); END;

CREATE TABLE golden_set (
    bus TEXT NOT NULL,
    unit INTEGER NOT NULL,
    set_id INTEGER NOT NULL REFERENCES parameter_set (id),
    marked_by TEXT NOT NULL,
    marked_at REAL NOT NULL,
    PRIMARY KEY (bus, unit)
) WITHOUT ROWID;

-- Minutes after local midnight at which the sets of a bus are taken each day.
CREATE TABLE set_schedule (
    bus TEXT PRIMARY KEY,
    minute_of_day INTEGER NOT NULL CHECK (minute_of_day BETWEEN 0 AND 1439)
) WITHOUT ROWID;
