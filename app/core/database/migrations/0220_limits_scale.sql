-- The decimals that the limits of a unit were typed with; NULL: they were given raw.
CREATE TABLE limits_scale (
    bus      TEXT    NOT NULL,
    unit     INTEGER NOT NULL,
    decimals INTEGER,
    PRIMARY KEY (bus, unit)
) STRICT, WITHOUT ROWID;
