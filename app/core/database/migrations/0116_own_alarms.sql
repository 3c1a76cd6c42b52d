-- The site's own alarms that were added on the page. A change is another row with another version: none is used twice.
CREATE TABLE own_alarm (
    version    INTEGER PRIMARY KEY AUTOINCREMENT,
    alarm      TEXT    NOT NULL UNIQUE,
    settings   TEXT    NOT NULL,
    who        TEXT    NOT NULL,
    changed_at REAL    NOT NULL,
    request    TEXT    NOT NULL
) STRICT;
