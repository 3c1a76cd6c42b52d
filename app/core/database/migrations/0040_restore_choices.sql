-- Why a row was left out and why a restore stopped, for programs; NULL in restores of an older version.
ALTER TABLE restore_left_out ADD COLUMN code TEXT;
ALTER TABLE restore ADD COLUMN cause_code TEXT;
