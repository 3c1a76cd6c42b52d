-- Pictures of notes by the SHA-256 of their content. None is ever changed.
CREATE TABLE picture (
    digest     TEXT PRIMARY KEY,
    media_type TEXT NOT NULL,
    content    BLOB NOT NULL
) STRICT, WITHOUT ROWID;

CREATE TRIGGER picture_stays_as_stored BEFORE UPDATE ON picture
BEGIN SELECT RAISE(ABORT, 'a picture is never changed'); END;
CREATE TRIGGER picture_stays BEFORE DELETE ON picture
BEGIN SELECT RAISE(ABORT, 'a picture is never removed'); END;
