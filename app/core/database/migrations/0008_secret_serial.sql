-- Counts the passwords or PINs that a user has had. It stays where the same one is hashed with other parameters.
ALTER TABLE users ADD COLUMN secret_serial INTEGER NOT NULL DEFAULT 0;
