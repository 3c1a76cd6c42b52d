-- When an alarm came, cleared and was acknowledged are three times. Of one that has cleared and waits, its present state
-- began when it cleared; of one that a person has acknowledged since, that is not known.
ALTER TABLE alarm_facts RENAME COLUMN risen_at TO came;
ALTER TABLE alarm_facts ADD COLUMN cleared REAL;
UPDATE alarm_facts SET cleared = since
WHERE active = 0 AND acknowledged = 0 AND shelved_until IS NULL AND suppressed = 0 AND out_of_service = 0;
