-- Set when a user signs in with a password or PIN that today's rules refuse; a new one clears it.
ALTER TABLE users ADD COLUMN weak_secret INTEGER NOT NULL DEFAULT 0;
