-- When an event came into the audit log that was first logged locally, while the database was away; else NULL.
ALTER TABLE events ADD COLUMN entered_at REAL;

-- Each transaction that may also be in a local log, by its reference, so that it is written once. events: the numbers
-- of its events, as JSON; entered_at: when it came out of a local log, NULL where it was written directly.
CREATE TABLE local_transaction (
    ref        TEXT NOT NULL PRIMARY KEY,
    at         REAL NOT NULL,
    events     TEXT NOT NULL,
    entered_at REAL
) STRICT;
CREATE INDEX local_transaction_by_time ON local_transaction (at);
