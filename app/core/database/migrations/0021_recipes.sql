-- Setpoint recipes: a new version beside the old ones, never a change of one.
CREATE TABLE recipe (
    id INTEGER PRIMARY KEY,
    bus TEXT NOT NULL,
    name TEXT NOT NULL,
    version INTEGER NOT NULL,
    comment TEXT NOT NULL,
    who TEXT NOT NULL,
    saved_at REAL NOT NULL,
    retired INTEGER NOT NULL DEFAULT 0,
    UNIQUE (bus, name, version)
);

CREATE TABLE recipe_row (
    recipe_id INTEGER NOT NULL REFERENCES recipe (id),
    unit INTEGER NOT NULL,
    raw INTEGER NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('speed', 'ratio')),
    PRIMARY KEY (recipe_id, unit)
) WITHOUT ROWID;

CREATE TABLE loaded_recipe (
    bus TEXT PRIMARY KEY,
    recipe_id INTEGER NOT NULL REFERENCES recipe (id),
    who TEXT NOT NULL,
    loaded_at REAL NOT NULL
) WITHOUT ROWID;
