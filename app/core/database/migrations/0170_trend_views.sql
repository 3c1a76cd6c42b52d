-- What people look at on the trends page, under a name: the address of the page, without its path. sender: the
-- account with the time of its creation, so that a later account of the same name has none of these.
CREATE TABLE trend_view (
    id       INTEGER PRIMARY KEY AUTOINCREMENT,
    sender   TEXT    NOT NULL,
    owner    TEXT    NOT NULL,
    name     TEXT    NOT NULL,
    query    TEXT    NOT NULL,
    shared   INTEGER NOT NULL,
    saved_at REAL    NOT NULL,
    UNIQUE (sender, name)
) STRICT;
CREATE INDEX trend_view_shared ON trend_view (shared);
