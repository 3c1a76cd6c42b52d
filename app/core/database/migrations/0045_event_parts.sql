-- Which events are parts of one change of several units. It only groups what is shown: the events themselves are
-- sealed by the chain and stay as they were written.
CREATE TABLE event_parts (
    event INTEGER PRIMARY KEY REFERENCES events (id),
    whole INTEGER NOT NULL REFERENCES events (id)
) STRICT;
CREATE INDEX event_parts_by_whole ON event_parts (whole);

-- Until now a part was known by its words, and came right after the event of the complete change.
INSERT INTO event_parts (event, whole)
SELECT part.id, whole.id
FROM events AS part
JOIN events AS whole ON whole.id = (
    SELECT max(nearest.id) FROM events AS nearest
    WHERE nearest.id < part.id AND nearest.id > part.id - 256 AND nearest.unit IS NULL
)
WHERE part.kind = 'command' AND part.about IS NULL AND part.unit IS NOT NULL
  AND (part.what LIKE 'set speed, one of % at once (82h, 83h)'
       OR part.what = 'execute staged speed, with every unit (83h to all)')
  AND whole.kind = 'command' AND whole.about IS NULL
  AND whole.bus = part.bus AND whole.who = part.who AND whole.origin = part.origin;
