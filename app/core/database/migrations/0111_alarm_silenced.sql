-- Whether the sound of an alarm was ended apart from its acknowledgement.
ALTER TABLE alarm_facts ADD COLUMN silenced INTEGER NOT NULL DEFAULT 0;
