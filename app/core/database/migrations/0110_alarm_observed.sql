-- When the alarms of a bus, or of the site ('_'), were observed. Where the journal is older, it is the evidence.
CREATE TABLE alarm_observed (
    place  TEXT NOT NULL,
    starts REAL NOT NULL,
    ends   REAL NOT NULL,
    PRIMARY KEY (place, starts)
) STRICT;
CREATE INDEX alarm_observed_by_end ON alarm_observed (ends);

INSERT INTO alarm_observed (place, starts, ends)
SELECT COALESCE(bus, '_'), MIN(at), MAX(at) FROM alarm_journal GROUP BY 1;
