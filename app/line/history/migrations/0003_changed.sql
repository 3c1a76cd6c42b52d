-- What changed, for incremental backups: every part of the store that has, or had, rows, with a version that is another one
-- after each change. Versions are random and not counted: two stores that went on from the same backup never give one version to
-- two contents.
-- 'minute': blocks of a minute, by 10 minutes; 'hour': packed blocks, by the hour; 'rest': all other rows, by the hour, bits
-- by the hour in which they end, as that of the newest is moved on while it lasts.
CREATE TABLE changed (
    kind TEXT NOT NULL,
    start INTEGER NOT NULL,
    version INTEGER NOT NULL,
    PRIMARY KEY (kind, start)
) STRICT, WITHOUT ROWID;
INSERT INTO changed SELECT kind, start, random() FROM (
    SELECT 'minute' AS kind, start - start % 600000000 AS start FROM raw WHERE span = 60000000
    UNION SELECT 'hour', start - start % 3600000000 FROM raw WHERE span > 60000000
    UNION SELECT 'rest', start FROM minutes
    UNION SELECT 'rest', start FROM hours
    UNION SELECT 'rest', at - at % 3600000000 FROM link
    UNION SELECT 'rest', until - until % 3600000000 FROM bits
);

CREATE TRIGGER raw_insert AFTER INSERT ON raw BEGIN
    INSERT INTO changed VALUES (iif(NEW.span = 60000000, 'minute', 'hour'), NEW.start - NEW.start % iif(NEW.span = 60000000, 600000000, 3600000000), random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER raw_update AFTER UPDATE ON raw BEGIN
    INSERT INTO changed VALUES (iif(OLD.span = 60000000, 'minute', 'hour'), OLD.start - OLD.start % iif(OLD.span = 60000000, 600000000, 3600000000), random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
    INSERT INTO changed VALUES (iif(NEW.span = 60000000, 'minute', 'hour'), NEW.start - NEW.start % iif(NEW.span = 60000000, 600000000, 3600000000), random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER raw_delete AFTER DELETE ON raw BEGIN
    INSERT INTO changed VALUES (iif(OLD.span = 60000000, 'minute', 'hour'), OLD.start - OLD.start % iif(OLD.span = 60000000, 600000000, 3600000000), random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER minutes_insert AFTER INSERT ON minutes BEGIN
    INSERT INTO changed VALUES ('rest', NEW.start - NEW.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER minutes_update AFTER UPDATE ON minutes BEGIN
    INSERT INTO changed VALUES ('rest', OLD.start - OLD.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
    INSERT INTO changed VALUES ('rest', NEW.start - NEW.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER minutes_delete AFTER DELETE ON minutes BEGIN
    INSERT INTO changed VALUES ('rest', OLD.start - OLD.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER hours_insert AFTER INSERT ON hours BEGIN
    INSERT INTO changed VALUES ('rest', NEW.start - NEW.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER hours_update AFTER UPDATE ON hours BEGIN
    INSERT INTO changed VALUES ('rest', OLD.start - OLD.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
    INSERT INTO changed VALUES ('rest', NEW.start - NEW.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER hours_delete AFTER DELETE ON hours BEGIN
    INSERT INTO changed VALUES ('rest', OLD.start - OLD.start % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER bits_insert AFTER INSERT ON bits BEGIN
    INSERT INTO changed VALUES ('rest', NEW.until - NEW.until % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER bits_update AFTER UPDATE ON bits BEGIN
    INSERT INTO changed VALUES ('rest', OLD.until - OLD.until % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
    INSERT INTO changed VALUES ('rest', NEW.until - NEW.until % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER bits_delete AFTER DELETE ON bits BEGIN
    INSERT INTO changed VALUES ('rest', OLD.until - OLD.until % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER link_insert AFTER INSERT ON link BEGIN
    INSERT INTO changed VALUES ('rest', NEW.at - NEW.at % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER link_update AFTER UPDATE ON link BEGIN
    INSERT INTO changed VALUES ('rest', OLD.at - OLD.at % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
    INSERT INTO changed VALUES ('rest', NEW.at - NEW.at % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;

CREATE TRIGGER link_delete AFTER DELETE ON link BEGIN
    INSERT INTO changed VALUES ('rest', OLD.at - OLD.at % 3600000000, random())
    ON CONFLICT (kind, start) DO UPDATE SET version = excluded.version;
END;
