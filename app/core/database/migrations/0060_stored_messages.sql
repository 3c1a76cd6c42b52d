-- The texts of restores and swaps, as codes and values (JSON). A text from before is kept as it is, in English.
UPDATE restore SET cause = CASE cause WHEN '' THEN '[]'
    ELSE json_array(json_object('code', 'term', 'params', json_object('text', cause))) END;
UPDATE restore_row SET message = CASE message WHEN '' THEN '[]'
    ELSE json_array(json_object('code', 'term', 'params', json_object('text', message))) END;
UPDATE restore_left_out
    SET reason = json_array(json_object('code', 'term', 'params', json_object('text', reason)));
-- One line each: a line break stands as \n in the JSON of the text.
UPDATE swap SET seen = CASE seen WHEN '' THEN '[]'
    ELSE '[{"code":"term","params":{"text":'
        || replace(json_quote(seen), '\n', '"}},{"code":"term","params":{"text":"') || '}}]' END;
