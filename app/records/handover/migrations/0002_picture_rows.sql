-- Each row on pages that only it has. Without a rowid the content was a part of the key: to find one picture others were
-- read, and one damaged page made all of them unreadable.
ALTER TABLE picture RENAME TO picture_by_key;
DROP TRIGGER picture_stays_as_stored;
DROP TRIGGER picture_stays;

CREATE TABLE picture (
    digest     TEXT PRIMARY KEY,
    media_type TEXT NOT NULL,
    content    BLOB NOT NULL
) STRICT;
INSERT INTO picture SELECT digest, media_type, content FROM picture_by_key;
DROP TABLE picture_by_key;

CREATE TRIGGER picture_stays_as_stored BEFORE UPDATE ON picture
BEGIN SELECT RAISE(ABORT, 'a picture is never changed'); END;
CREATE TRIGGER picture_stays BEFORE DELETE ON picture
BEGIN SELECT RAISE(ABORT, 'a picture is never removed'); END;
