-- Sheets that were signed over, as they were then. Neither they nor their signatures are ever changed.
CREATE TABLE shift_sheet (
    start       REAL PRIMARY KEY,
    ends        REAL NOT NULL,
    sheet       BLOB NOT NULL,
    digest      TEXT NOT NULL,
    page        BLOB NOT NULL,
    page_digest TEXT NOT NULL
) STRICT;

CREATE TABLE shift_signature (
    start REAL    NOT NULL REFERENCES shift_sheet (start),
    part  TEXT    NOT NULL CHECK (part IN ('leaving', 'coming')),
    who   TEXT    NOT NULL,
    at    REAL    NOT NULL,
    event INTEGER NOT NULL REFERENCES events (id),
    PRIMARY KEY (start, part)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER shift_sheet_stays_as_signed BEFORE UPDATE ON shift_sheet
BEGIN SELECT RAISE(ABORT, 'a signed sheet is never changed'); END;
CREATE TRIGGER shift_sheet_stays BEFORE DELETE ON shift_sheet
BEGIN SELECT RAISE(ABORT, 'a signed sheet is never removed'); END;
CREATE TRIGGER shift_signature_stays_as_written BEFORE UPDATE ON shift_signature
BEGIN SELECT RAISE(ABORT, 'a signature is never changed'); END;
CREATE TRIGGER shift_signature_stays BEFORE DELETE ON shift_signature
BEGIN SELECT RAISE(ABORT, 'a signature is never removed'); END;
