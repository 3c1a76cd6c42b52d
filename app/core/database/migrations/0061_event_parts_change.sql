-- A part of a change of several units names its change.
ALTER TABLE event_parts RENAME COLUMN whole TO change;
DROP INDEX event_parts_by_whole;
CREATE INDEX event_parts_by_change ON event_parts (change);
