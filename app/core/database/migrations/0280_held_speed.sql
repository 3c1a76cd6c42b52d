-- The units that may hold a staged speed (82h), which no request reads back: the next worker is told of them.
CREATE TABLE held_speed (
    bus   TEXT    NOT NULL,
    unit  INTEGER NOT NULL,
    PRIMARY KEY (bus, unit)
) STRICT, WITHOUT ROWID;
