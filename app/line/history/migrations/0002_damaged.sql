-- Blocks that could not be read, out of the way of the rest and kept because another program may still read
-- some of them. A row with tier 'store' and unit 0: the complete store was rewritten from what was readable.
CREATE TABLE damaged (
    tier TEXT NOT NULL,
    unit INTEGER NOT NULL,
    start INTEGER NOT NULL,
    found INTEGER NOT NULL,
    data BLOB,
    PRIMARY KEY (tier, unit, start, found)
) STRICT;
