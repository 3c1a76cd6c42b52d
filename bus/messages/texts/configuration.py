"""Texts about lineside.toml."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "configuration_exists": (
        "{file} exists and is kept. Name another file with --config, or move this one away."
    ),
    "configuration_not_writable": (
        "{file} cannot be written: {error}. Create its folder, or name another file with --config."
    ),
    "configuration_key_in_data": (
        "{file}: audit.key_file = '{path}' is in the data folder: anyone who can write the log "
        "there could seal it; name a file in another folder"
    ),
    "configuration_lacks_bus": "{file}: there is no [[bus]] named '{bus}'; it has {known}",
    "configuration_missing": "{file}: there is no such file; name one with --config FILE",
    "configuration_beyond_bounds": (
        "{file}: a number in it has too many digits or a list too many brackets; compare the file "
        "that 'lineside init' writes"
    ),
    "configuration_not_utf8": "{file}: this is not UTF-8 text; save it as that",
    "configuration_unreadable": "{file}: cannot be read: {error}",
    "configuration_not_toml": (
        '{file}:{line}: this is not TOML: {error}; the line is {text}; write key = value, text in "quotes"'
    ),
    "configuration_fault": "{file}:{line}: {fault}",
    "configuration_needs_key": "{table} needs {key} = …",
    "configuration_refused": "{reason}",
    "configuration_needs_array": "write [[{table}]] instead of [{table}], as there may be several",
    "configuration_value": "{key} = {value}: {right}",
    "configuration_slug": "write small letters, digits and hyphens between them, like dry-end",
    "configuration_key_near": "did you mean {key}?",
    "configuration_keys_known": "known here: {keys}",
    "configuration_key_unknown": "unknown key {key} in {table}; {right}",
}
