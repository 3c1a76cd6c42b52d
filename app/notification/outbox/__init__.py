"""From the journal of alarms to an outbox that outlives a restart."""
