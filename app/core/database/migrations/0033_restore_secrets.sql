-- The operator password (#21) is kept in parameter sets alone: what restores have noted of it is overwritten.
PRAGMA secure_delete = ON;
UPDATE restore_row SET present = -1, wanted = -1, read_back = NULL WHERE number = 21;
UPDATE restore_value SET raw = NULL WHERE number = 21;
