-- One hash chain for each bus, and one for the site (''), which continues the chain that was. chain: NULL in the
-- entries of that time. The first entry of the chain of a bus continues that of the site, and is an entry of both.
ALTER TABLE events ADD COLUMN chain TEXT;

-- The newest entry of each chain, kept apart so that a chain cut off at its end is noticed.
CREATE TABLE chain_head (
    chain TEXT    NOT NULL PRIMARY KEY,
    id    INTEGER NOT NULL,
    hash  TEXT    NOT NULL,
    key   TEXT    NOT NULL,
    seal  TEXT    NOT NULL
) STRICT, WITHOUT ROWID;
INSERT INTO chain_head (chain, id, hash, key, seal) SELECT '', id, hash, key, seal FROM events_head;
DROP TABLE events_head;
ALTER TABLE chain_head RENAME TO events_head;
CREATE TRIGGER events_head_goes_forward BEFORE UPDATE ON events_head WHEN NEW.id <= OLD.id
BEGIN SELECT RAISE(ABORT, 'the head of the log only goes forward'); END;
CREATE TRIGGER events_head_stays BEFORE DELETE ON events_head
BEGIN SELECT RAISE(ABORT, 'the head of the log is never removed'); END;
