-- By this the servers of a site know each other: a server proves with it what it states of a request that it passes on.
CREATE TABLE site_secret (id INTEGER PRIMARY KEY CHECK (id = 1), secret BLOB NOT NULL);
