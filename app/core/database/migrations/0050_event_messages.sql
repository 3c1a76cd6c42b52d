-- The text of an entry as codes and values (JSON: field → message), beside its text in English; entries from before have
-- their text alone. The hash of an entry covers it.
ALTER TABLE events ADD COLUMN messages TEXT;
