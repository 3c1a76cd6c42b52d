-- Users of a provider of company accounts (OpenID Connect): who issues the account, and its subject there. They have
-- no password: secret_hash is empty. A user whose password is here has neither.
ALTER TABLE users ADD COLUMN issuer TEXT;
ALTER TABLE users ADD COLUMN subject TEXT;
CREATE UNIQUE INDEX users_by_subject ON users (issuer, subject);
