-- How far what is stored was published to the plant's database, by kind of rows, and as who this site is known there.
CREATE TABLE publisher_cursor (
    name  TEXT    PRIMARY KEY,
    value INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE publisher_identity (
    only INTEGER PRIMARY KEY CHECK (only = 1),
    id   TEXT    NOT NULL
) STRICT;
INSERT INTO publisher_identity VALUES (1, lower(hex(randomblob(16))));
