-- The pictures of a note: their SHA-256, separated by blanks.
ALTER TABLE shift_note ADD COLUMN pictures TEXT NOT NULL DEFAULT '';
