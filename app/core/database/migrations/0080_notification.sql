-- Transitions to be notified (items), the messages that it leaves in (deliveries), and how far the journal of alarms
-- was followed. An item is made once: its key names the transition, the rule and the address.
CREATE TABLE notification_cursor (
    source TEXT    PRIMARY KEY,
    entry  INTEGER NOT NULL
) STRICT;

CREATE TABLE notification_episode (
    alarm            TEXT    PRIMARY KEY,
    source           TEXT    NOT NULL,
    entry            INTEGER NOT NULL,
    occurrence       INTEGER NOT NULL,
    bus              TEXT,
    priority         TEXT    NOT NULL,
    at               REAL    NOT NULL,
    notified_after_s REAL    NOT NULL
) STRICT;

CREATE TABLE notification_delivery (
    id         INTEGER PRIMARY KEY AUTOINCREMENT,
    endpoint   TEXT    NOT NULL,
    message_id TEXT    NOT NULL UNIQUE,
    state      TEXT    NOT NULL,
    attempts   INTEGER NOT NULL,
    created_at REAL    NOT NULL,
    tried_at   REAL    NOT NULL,
    due        REAL    NOT NULL,
    result     TEXT    NOT NULL
) STRICT;
CREATE INDEX notification_delivery_by_attempt ON notification_delivery (endpoint, tried_at);
CREATE INDEX notification_delivery_retrying ON notification_delivery (endpoint) WHERE state = 'retrying';

CREATE TABLE notification_item (
    id         INTEGER PRIMARY KEY AUTOINCREMENT,
    key        TEXT    NOT NULL,
    endpoint   TEXT    NOT NULL,
    kind       TEXT    NOT NULL,
    created_at REAL    NOT NULL,
    notice     TEXT,
    alarm      TEXT    NOT NULL,
    occurrence INTEGER NOT NULL,
    delivery   INTEGER REFERENCES notification_delivery (id),
    UNIQUE (key, endpoint)
) STRICT;
CREATE INDEX notification_item_of_alarm ON notification_item (alarm, occurrence);
CREATE INDEX notification_item_of_delivery ON notification_item (delivery);
CREATE INDEX notification_item_waiting ON notification_item (endpoint, id) WHERE delivery IS NULL;

CREATE TABLE notification_quiet (
    id     INTEGER PRIMARY KEY AUTOINCREMENT,
    bus    TEXT,
    starts REAL    NOT NULL,
    ends   REAL    NOT NULL,
    who    TEXT    NOT NULL,
    reason TEXT    NOT NULL
) STRICT;

CREATE TABLE notification_key (
    id  INTEGER PRIMARY KEY CHECK (id = 1),
    key BLOB    NOT NULL
) STRICT;
