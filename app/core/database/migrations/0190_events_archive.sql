-- Where old events went: each row is a file of the archive with the entries first to last, sealed with the audit key.
-- first_hash: of the first entry of the log; heads: the end of each chain at last, as JSON. Only what a row covers may
-- be removed.
CREATE TABLE events_archive (
    last       INTEGER NOT NULL PRIMARY KEY,
    first      INTEGER NOT NULL,
    file       TEXT    NOT NULL,
    digest     TEXT    NOT NULL,
    first_hash TEXT    NOT NULL,
    heads      TEXT    NOT NULL,
    at         REAL    NOT NULL,
    key        TEXT    NOT NULL,
    seal       TEXT    NOT NULL
) STRICT;
CREATE TRIGGER events_archive_stays_as_written BEFORE UPDATE ON events_archive
BEGIN SELECT RAISE(ABORT, 'the list of archived events is never changed'); END;
CREATE TRIGGER events_archive_stays BEFORE DELETE ON events_archive
BEGIN SELECT RAISE(ABORT, 'the list of archived events is never shortened'); END;

DROP TRIGGER events_stay;
CREATE TRIGGER events_stay BEFORE DELETE ON events
WHEN OLD.id > COALESCE((SELECT max(last) FROM events_archive), 0)
BEGIN SELECT RAISE(ABORT, 'an event is never removed before it is archived'); END;
