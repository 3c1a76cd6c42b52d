-- Buses whose units take no command until a time or, where that is NULL, until an administrator ends it.
CREATE TABLE read_only (
    bus    TEXT NOT NULL PRIMARY KEY,
    reason TEXT NOT NULL,
    set_by TEXT NOT NULL,
    set_at REAL NOT NULL,
    until  REAL
) STRICT;
