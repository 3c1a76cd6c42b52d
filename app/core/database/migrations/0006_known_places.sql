-- From where each user has signed in: networks by address and browsers by the hash of a cookie. Failed sign-ins
-- from elsewhere do not slow these down.
CREATE TABLE known_places (
    name    TEXT NOT NULL REFERENCES users (name) ON DELETE CASCADE ON UPDATE CASCADE,
    place   TEXT NOT NULL,
    seen_at REAL NOT NULL,
    PRIMARY KEY (name, place)
) STRICT, WITHOUT ROWID;
