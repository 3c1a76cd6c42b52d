-- Commands whose sender gave them an id, kept so that the id, given again, is never carried out a second time.
-- command: what was requested, as a hash. The last column is the result as JSON; NULL while it is not known.
CREATE TABLE asked (
    id       TEXT PRIMARY KEY,
    asked_at REAL NOT NULL,
    command  TEXT NOT NULL,
    fate     BLOB
) STRICT, WITHOUT ROWID;
CREATE INDEX asked_by_time ON asked (asked_at);
