-- A search reads the events: an index of trigrams made every entry of the log wait for its own, and is not needed.
DROP TRIGGER IF EXISTS events_text_follows;
DROP TABLE IF EXISTS events_text;
DROP TABLE IF EXISTS events_text_extent;
