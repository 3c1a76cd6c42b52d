-- A restore is one value, stored as JSON: its tables of rows, of rows left out and of values become members of it.
CREATE TABLE restore_content (
    id TEXT PRIMARY KEY,
    bus TEXT NOT NULL,
    unit INTEGER NOT NULL,
    planned_at REAL NOT NULL,
    state TEXT NOT NULL,
    content TEXT NOT NULL
) WITHOUT ROWID;

-- Messages were stored as lists of at most one.
WITH side AS (
    SELECT restore_id, side, json_group_object(CAST(number AS TEXT), json_object(
        'number', number, 'raw', raw, 'available', json(iif(available, 'true', 'false')), 'read_at', read_at
    )) AS content
    FROM restore_value GROUP BY restore_id, side
), written AS (
    SELECT restore_id, json_group_array(json_object(
        'write', json_object('number', number, 'present', present, 'wanted', wanted), 'outcome', outcome,
        'message', json(iif(json_valid(message), json_extract(message, '$[0]'), NULL)), 'read_back', read_back
    )) AS content
    FROM (SELECT * FROM restore_row ORDER BY restore_id, place) GROUP BY restore_id
), left_out AS (
    SELECT restore_id, json_group_array(json_object(
        'number', number, 'reason', coalesce(code, iif(later, 'not_in_remote', NULL)),
        'text', json(coalesce(
            iif(json_valid(reason), json_extract(reason, '$[0]'), NULL), '{"code":"stored_text_unreadable"}'))
    )) AS content
    FROM (SELECT * FROM restore_left_out ORDER BY restore_id, number) GROUP BY restore_id
)
INSERT INTO restore_content SELECT id, bus, unit, planned_at, state, json_object(
    'id', id, 'bus', bus, 'unit', unit, 'who', who, 'planned_at', planned_at, 'state', state,
    'cause', json(iif(json_valid(cause), json_extract(cause, '$[0]'), NULL)), 'cause_code', cause_code,
    'wanted', json_object('unit', unit, 'name', unit_name, 'rows', json(coalesce(
        (SELECT content FROM side WHERE restore_id = restore.id AND side = 'wanted'), '{}'))),
    'before', json_object('unit', unit, 'name', unit_name, 'rows', json(coalesce(
        (SELECT content FROM side WHERE restore_id = restore.id AND side = 'before'), '{}'))),
    'proven', (SELECT json_object('unit', unit, 'name', unit_name, 'rows', json(content))
        FROM side WHERE restore_id = restore.id AND side = 'proven'),
    'rows', json(coalesce((SELECT content FROM written WHERE restore_id = restore.id), '[]')),
    'plan', json_object(
        'writes', (SELECT json_group_array(json(json_extract(value, '$.write'))) FROM json_each(
            (SELECT content FROM written WHERE restore_id = restore.id))),
        'left_out', json(coalesce((SELECT content FROM left_out WHERE restore_id = restore.id), '[]')),
        'equal', equal_rows)
) FROM restore;

DROP TABLE restore_row;
DROP TABLE restore_left_out;
DROP TABLE restore_value;
DROP TABLE restore;
ALTER TABLE restore_content RENAME TO restore;
CREATE INDEX restore_by_unit ON restore (bus, unit, planned_at);
