-- What each edge node has sent to the plant's broker: the number of its last connection, up to when everything was
-- received (µs), and the spans of readings, by unit, that were not received.
CREATE TABLE mqtt_node (
    bus       TEXT    PRIMARY KEY,
    bd_seq    INTEGER NOT NULL,
    received  INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE mqtt_unsent (
    bus   TEXT    NOT NULL,
    unit  INTEGER NOT NULL,
    start INTEGER NOT NULL,
    until INTEGER NOT NULL,
    PRIMARY KEY (bus, unit, start)
) STRICT, WITHOUT ROWID;
