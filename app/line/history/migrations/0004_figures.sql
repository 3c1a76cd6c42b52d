-- What a report says of a unit and a packed hour, so that it reads no readings again. Absent ones are worked out, the newest first.
-- Late readings, and marks of a lost unit or port, delete those of every unit of the bus within two minutes of them, as a draw is
-- of two units. Readings that are given up for their age leave them as they are.
CREATE TABLE figures (
    unit INTEGER NOT NULL REFERENCES unit (id),
    start INTEGER NOT NULL,
    data BLOB NOT NULL,
    PRIMARY KEY (unit, start)
) STRICT, WITHOUT ROWID;

CREATE TRIGGER figures_of_minute AFTER INSERT ON raw WHEN NEW.span = 60000000 BEGIN
    DELETE FROM figures WHERE unit IN (SELECT other.id FROM unit JOIN unit AS other ON other.bus = unit.bus WHERE unit.id = NEW.unit)
    AND start > NEW.start - 3720000000 AND start < NEW.start + 180000000;
END;

-- A late reading replaces the block of its hour.
CREATE TRIGGER figures_of_hour AFTER DELETE ON raw
WHEN OLD.span > 60000000 AND OLD.start >= coalesce((SELECT value FROM fact WHERE name = 'raw_from'), 0) BEGIN
    DELETE FROM figures WHERE unit IN (SELECT other.id FROM unit JOIN unit AS other ON other.bus = unit.bus WHERE unit.id = OLD.unit)
    AND start > OLD.start - 3720000000 AND start < OLD.start + 3720000000;
END;

CREATE TRIGGER figures_of_link AFTER INSERT ON link BEGIN
    DELETE FROM figures WHERE unit IN (SELECT other.id FROM unit JOIN unit AS other ON other.bus = unit.bus WHERE unit.id = NEW.unit)
    AND start > NEW.at - 3720000000 AND start < NEW.at + 120000000;
END;
