-- A worker's token speaks for one bus, and a token may expire. One of role worker from before names no bus and
-- is refused until it is replaced: which bus it was meant for is not known here.
ALTER TABLE tokens ADD COLUMN bus TEXT;
ALTER TABLE tokens ADD COLUMN expires_at REAL;
