-- People and panels who sign in, their sessions, and the tokens of programs.
CREATE TABLE users (
    name          TEXT    PRIMARY KEY,
    role          TEXT    NOT NULL CHECK (role IN ('viewer', 'operator', 'engineer', 'admin')),
    secret_hash   TEXT    NOT NULL,
    panel         INTEGER NOT NULL DEFAULT 0,
    home          TEXT    NOT NULL DEFAULT '/',
    language      TEXT    NOT NULL DEFAULT '',
    disabled      INTEGER NOT NULL DEFAULT 0,
    created_at    REAL    NOT NULL,
    seen_at       REAL
) STRICT, WITHOUT ROWID;

-- A session is known by the hash of the random token that the browser's cookie holds.
CREATE TABLE sessions (
    hash       BLOB PRIMARY KEY,
    name       TEXT NOT NULL REFERENCES users (name) ON DELETE CASCADE ON UPDATE CASCADE,
    created_at REAL NOT NULL,
    used_at    REAL NOT NULL,
    expires_at REAL NOT NULL
) STRICT, WITHOUT ROWID;
CREATE INDEX sessions_by_name ON sessions (name);

CREATE TABLE tokens (
    id         INTEGER PRIMARY KEY,
    hash       BLOB NOT NULL UNIQUE,
    name       TEXT NOT NULL UNIQUE,
    role       TEXT NOT NULL CHECK (role IN ('viewer', 'operator', 'engineer', 'admin', 'worker')),
    created_by TEXT NOT NULL,
    created_at REAL NOT NULL,
    used_at    REAL
) STRICT;
