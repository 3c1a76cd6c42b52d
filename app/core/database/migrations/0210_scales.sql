-- What the setpoint of a recipe was shown with when it was saved, as app.line.commands.scale writes it; empty: not known.
ALTER TABLE recipe_row ADD COLUMN scale TEXT NOT NULL DEFAULT '';
