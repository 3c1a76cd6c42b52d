-- The facts of each alarm that has ever left its first state, and every transition, which is never changed.
CREATE TABLE alarm_facts (
    alarm           TEXT    PRIMARY KEY,
    active          INTEGER NOT NULL,
    acknowledged    INTEGER NOT NULL,
    latched         INTEGER NOT NULL,
    suppressed      INTEGER NOT NULL,
    out_of_service  INTEGER NOT NULL,
    shelved_until   REAL,
    shelved_once    INTEGER NOT NULL,
    occurrence      INTEGER NOT NULL,
    since           REAL,
    risen_at        REAL,
    acknowledged_at REAL,
    first_out       INTEGER NOT NULL,
    hidden_by       TEXT    NOT NULL,
    reason          TEXT    NOT NULL
) STRICT;

CREATE TABLE alarm_journal (
    id         INTEGER PRIMARY KEY AUTOINCREMENT,
    at         REAL    NOT NULL,
    alarm      TEXT    NOT NULL,
    occurrence INTEGER NOT NULL,
    code       TEXT    NOT NULL,
    name       TEXT    NOT NULL,
    bus        TEXT,
    unit       INTEGER,
    priority   TEXT    NOT NULL,
    trigger    TEXT    NOT NULL,
    before     TEXT    NOT NULL,
    after      TEXT    NOT NULL,
    who        TEXT    NOT NULL,
    reason     TEXT    NOT NULL
) STRICT;
CREATE INDEX alarm_journal_by_alarm ON alarm_journal (alarm, id);
CREATE INDEX alarm_journal_by_time ON alarm_journal (at);
CREATE INDEX alarm_journal_annunciated ON alarm_journal (at, alarm, priority)
WHERE after = 'unack_active' AND before <> 'unack_active';

CREATE TRIGGER alarm_journal_stays_as_written BEFORE UPDATE ON alarm_journal
BEGIN SELECT RAISE(ABORT, 'a transition of an alarm is never changed'); END;
CREATE TRIGGER alarm_journal_stays BEFORE DELETE ON alarm_journal
BEGIN SELECT RAISE(ABORT, 'a transition of an alarm is never removed'); END;
