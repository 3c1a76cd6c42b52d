-- Swaps of a unit under way, and the last one of each section: a server that ends forgets none.
CREATE TABLE swap (
    bus TEXT NOT NULL,
    unit INTEGER NOT NULL,
    who TEXT NOT NULL,
    began_at REAL NOT NULL,
    -- The set and the unit in it that the spare shall become; without them it is entered from the sheet.
    set_id INTEGER REFERENCES parameter_set (id),
    set_unit INTEGER,
    is_new INTEGER NOT NULL,
    proven INTEGER NOT NULL,
    restore_id TEXT,
    -- What the wire showed, one line each, in order.
    seen TEXT NOT NULL,
    PRIMARY KEY (bus, unit)
) WITHOUT ROWID;
