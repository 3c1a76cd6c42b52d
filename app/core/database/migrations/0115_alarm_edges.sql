-- Where occurrences begin and end, without all that happened to an alarm meanwhile or while it was hidden.
CREATE INDEX alarm_journal_edges ON alarm_journal (alarm, id)
WHERE ((before IN ('unack_active', 'ack_active')) <> (after IN ('unack_active', 'ack_active')));
