-- The change trays, which a restart of the server does not empty. changes: JSON, a list of place, raw value and scale as
-- text, in the order of adding; sending: how many more were being sent, whose results are in the events.
CREATE TABLE tray (
    bus      TEXT    NOT NULL,
    sender   TEXT    NOT NULL,
    added_at REAL    NOT NULL,
    changes  TEXT    NOT NULL,
    sending  INTEGER NOT NULL,
    PRIMARY KEY (bus, sender)
) STRICT, WITHOUT ROWID;
