-- Entries are sealed with a key that is not in the store; those from before have none. count: how often what an
-- entry reports happened, where it was more than once.
ALTER TABLE events ADD COLUMN count INTEGER CHECK (count > 1);
ALTER TABLE events ADD COLUMN key TEXT NOT NULL DEFAULT '';
ALTER TABLE events ADD COLUMN seal TEXT NOT NULL DEFAULT '';
ALTER TABLE events_head ADD COLUMN key TEXT NOT NULL DEFAULT '';
ALTER TABLE events_head ADD COLUMN seal TEXT NOT NULL DEFAULT '';
