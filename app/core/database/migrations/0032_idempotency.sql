-- Commands whose sender gave them a key, kept so that the key, given again, is never carried out a second time.
-- command: what was requested, as a digest made with the server's key. result: as JSON; NULL while it is not known.
CREATE TABLE idempotency (
    sender       TEXT NOT NULL,
    key          TEXT NOT NULL,
    requested_at REAL NOT NULL,
    command      TEXT NOT NULL,
    result       BLOB,
    PRIMARY KEY (sender, key)
) STRICT, WITHOUT ROWID;
CREATE INDEX idempotency_by_time ON idempotency (requested_at);
CREATE INDEX idempotency_by_sender ON idempotency (sender, requested_at);

-- Keys from before name neither their sender nor, of a secret, what was requested: they are refused to every
-- sender until they are forgotten. Their results may hold a secret, which must not be left in free pages.
PRAGMA secure_delete = ON;
INSERT INTO idempotency SELECT '', id, asked_at, '', NULL FROM asked;
DROP TABLE asked;
