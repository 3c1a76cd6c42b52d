-- Which server is the home of each bus; '' is the site itself. Times are of the store's clock.
CREATE TABLE home (
    bus TEXT PRIMARY KEY,
    holder TEXT NOT NULL,
    -- The process of the holder: it distinguishes two servers with one name.
    instance TEXT NOT NULL,
    epoch INTEGER NOT NULL,
    until REAL NOT NULL,
    -- Counted up by each renewal: it distinguishes two that look alike, whatever the clock of the store did.
    renewals INTEGER NOT NULL,
    url TEXT NOT NULL,
    taken_at REAL NOT NULL,
    reason TEXT NOT NULL,
    -- The instance, once it has given the bus up.
    released TEXT NOT NULL,
    -- What a person asked for: which server is to take the bus, and until when that holds.
    requested_by TEXT NOT NULL,
    requested_for TEXT NOT NULL,
    request_ends REAL NOT NULL
);
-- The highest epoch of each bus. It outlives a row that is deleted by hand, and shows that it was there.
CREATE TABLE home_epoch (
    bus TEXT PRIMARY KEY,
    epoch INTEGER NOT NULL
);
