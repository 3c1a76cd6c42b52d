-- Every site has a secret of its own. Its hash names the site in a folder of backups, which takes those of one site only.
INSERT INTO site_secret (id, secret) VALUES (1, randomblob(32)) ON CONFLICT DO NOTHING;
