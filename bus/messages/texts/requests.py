"""Texts about requests: what they address, how they are written, how large they are."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "http_refused": "{reason}",
    "no_such_bus": "there is no bus '{bus}'; there are: {known}",
    "no_such_unit": "bus '{bus}' has no unit {unit} in lineside.toml",
    "parameter_unknown_none": "{name}: there is no such parameter; there are none; nothing was sent",
    "parameter_unknown": "{name}: there is no such parameter; there are: {known}; nothing was sent",
    "parameter_twice": "{name}: it is given twice; nothing was sent",
    "too_many_members": "an object has more than {n} members; nothing was sent",
    "field_unknown": "{name}: there is no such field; nothing was sent",
    "sent_at_malformed": (
        "Lineside-Sent-At: write one ISO 8601 time with its zone, such as "
        "2026-11-21T03:12:00.250Z; nothing was sent"
    ),
    "sent_at_in_future": (
        "Lineside-Sent-At is {ahead} s in the future; set the clock of the sender; nothing was sent"
    ),
    "no_such_file": "there is no file {path}",
    "body_over_megabytes": "more than {n} MB were sent; nothing was done",
    "body_over_kilobytes": "more than {n} kB were sent; nothing was done",
    "address_too_long": "no address here is that long",
    "content_type_too_long": "the Content-Type is too long; nothing was done",
    "form_charset": "a form must be in UTF-8; nothing was done",
    "came_too_late": (
        "the command came too late: it is {age} s old, and {allowed} s were allowed; nothing was "
        "sent. Send it again if it is still needed"
    ),
    "header_twice": "the request has two {name} headers; nothing was done",
    "host_missing": "the request has no Host header; nothing was done",
    "coding_unknown": "bodies are not decoded here: send them without {name}; nothing was done",
    "host_not_served": "this server is not called '{host}'; use a name of allowed_hosts",
    "body_not_json": "the body is not JSON; nothing was sent",
    "body_not_readable": "the body cannot be read; nothing was sent",
    "body_not_utf8": "the body is not UTF-8 text; nothing was sent",
    "server_failed": "server error; its log has the cause",
    "foreign_origin": ("the request came from a page of {origin}, not of this server; nothing was done"),
    "too_many_requests": "too many of your requests are waiting; wait until some have finished",
    "too_many_pages": "too many pages are open; close some",
    "too_many_streams": "too many streams are open; close some",
    "nothing_at_path": "there is no page at {path}",
    "method_not_for_path": "{method} is not for {path}; nothing was done",
    "fields_malformed": "{errors}; nothing was sent",
    "fault_at": "{where}: {fault}",
    "fault_missing": "it is missing",
    "fault_no_such_field": "there is no such field",
    "fault_not_an_object": 'it must be a JSON object, {"…": …}, sent as Content-Type: application/json',
    "fault_at_most_characters": Plural(
        "it must have at most 1 character", "it must have at most {n} characters"
    ),
    "fault_at_least_characters": Plural(
        "it must have at least 1 character", "it must have at least {n} characters"
    ),
    "fault_at_most_items": Plural("it must have at most 1 item", "it must have at most {n} items"),
    "fault_at_least_items": Plural("it must have at least 1 item", "it must have at least {n} items"),
    "fault_at_least": "it must be at least {limit}",
    "fault_at_most": "it must be at most {limit}",
    "fault_more_than": "it must be more than {limit}",
    "fault_less_than": "it must be less than {limit}",
    "fault_allowed": "it must be one of {values}",
    "fault_pattern": "it must match the pattern '{text}'",
    "fault_integer_too_large": "it is too large an integer",
    "fault_not_an_integer": "it must be an integer",
    "fault_not_a_number": "it must be a finite number",
    "fault_not_a_text": "it must be a text",
    "fault_not_a_list": "it must be a list",
    "fault_not_a_mapping": "it must be an object with named fields",
    "fault_not_a_time": "it must be a time in ISO 8601 with its zone, like 2026-11-22T06:00:00Z",
    "fault_not_true_or_false": "it must be true or false",
    "fault_malformed": "it is malformed",
    "control_character": "character {n} is a control character ({code}); leave it out",
    "number_given_twice": "{number} is given twice",
    "raw_or_value": "give either raw (the integer on the wire) or value (as shown)",
    "value_not_a_number": "value is a number as shown",
    "no_setpoint_left": "lowest is above highest, which allows no setpoint",
}
