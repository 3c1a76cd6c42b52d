"""Texts about history, its queries, and the stores on disk."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "history_disk_low": "the disk with the history is nearly full: free some space soon",
    "history_disk_scarce": ("the disk with the history is nearly full: the oldest values are being deleted"),
    "history_disk_full": "the disk is full: no values are stored until space is free",
    "history_failed": "no history is stored; everything else works",
    "history_failed_since": (
        "Since {time} no history is stored, everything else works. The reason: {reason}"
    ),
    "history_paused_since": (
        "No history, note or picture is stored since {time}: the disk is full. Free some space."
    ),
    "reserve_in_use": (
        "The disk is full. Commands, alarms and logins are recorded in reserved space, of which "
        "{percent} percent is left. Free some space."
    ),
    "history_notice": "History: {notice}",
    "history_because": "{notice}: {cause}",
    "history_damaged": (
        "History: stored values were damaged. The events list the values that are missing; all "
        "others are intact. Check the disk."
    ),
    "event_history_block_lost": (
        "a block of the history is damaged, it is missing: {what} of {unit} from {since} on"
    ),
    "event_history_block_rebuilt": (
        "a block of the history was damaged, it was worked out again: {what} of {unit} from {since} on"
    ),
    "event_history_rebuilt": Plural(
        (
            "the store of the history was damaged and was rebuilt; 1 time span is missing; the "
            "damaged store was saved as {file}"
        ),
        (
            "the store of the history was damaged and was rebuilt; {n} time spans are missing; the "
            "damaged store was saved as {file}"
        ),
    ),
    "event_history_tail_damaged": (
        "the last minutes of the history were damaged before this start, some are missing"
    ),
    "history_readings": "every value",
    "history_minutes": "the minutes",
    "history_hours": "the hours",
    "too_many_sparklines": "series: at most {most}, not {count}",
    "no_parquet": (
        "This server cannot write Parquet: pyarrow is not installed. Export CSV, or install "
        "lineside[parquet]."
    ),
    "series_malformed": "series: write bus/unit/value, such as {example}, not '{text}'",
    "series_count": "series: name from 1 to {most} values, not {count}",
    "time_malformed": "{field}: write an ISO 8601 time with its zone, such as {example}, not '{text}'",
    "year_out_of_range": "{name}: write a year from {lowest} to {highest}, not {year}",
    "span_reversed": "from: the start of the span must be before its end; exchange from and to",
    "points_out_of_range": (
        "points: from 1 to {most}; for every value of a long span, use /api/v1/history/export"
    ),
    "no_such_value": "value: there is no '{value}'; there are: {known}",
    # The stores on disk.
    "store_failed": "the store {path}: {reason}",
    "store_disk_full": "the disk is full; nothing was stored; free some space",
    "store_read_only": "it is read-only; give the server's user write access to it and its folder",
    "store_is_damaged": "it is damaged; restore a backup (lineside restore-store) or move it away",
    "store_foreign": ("it is not a Lineside store, or it is damaged; restore a backup or move it away"),
    "store_not_openable": "it cannot be opened; check that its folder exists and is accessible",
    "store_disk_failed": "disk error; check the disk",
    "store_locked": "another program has locked it; stop that program",
    "store_access_refused": "access to it is refused; give the server's user access",
    "store_missing_at_start": (
        "the store {path} is missing, and its audit key {key} is there. Mount its disk, or put a backup back "
        "with 'lineside restore-store'. To begin a new site instead: lineside serve --new"
    ),
    "store_empty_at_start": (
        "the store {path} is empty, and its audit key {key} is there. Put a backup back with 'lineside "
        "restore-store'. To begin a new site instead: lineside serve --new"
    ),
    "store_damaged_at_start": (
        "the store {path}: it is not a Lineside store, or it is damaged. Put a backup back with 'lineside "
        "restore-store'. To begin a new site instead, with the file put aside: lineside serve --new"
    ),
    "store_not_new": (
        "the store {path} holds a site; --new is only for one that is missing, empty or damaged. Start "
        "without --new."
    ),
    "store_was_missing": "missing",
    "store_was_empty": "empty",
    "store_was_damaged": "damaged; its file was put aside",
    "store_missing": "there is no store {path}; nothing was served with this configuration yet",
    "stores_missing": "there is no store in {folder}; nothing was served with this configuration yet",
    "backup_exists": "{file} exists already; name another file",
    "backup_malformed": "{file} is not a backup of Lineside's stores, or damaged: {error}",
    "backup_needs_space": (
        "the stores of {file} need {needed} bytes, and the disk has {free} free; make room, then restore"
    ),
    "backup_damaged": "{file} is damaged: {store} is not what was backed up; take another backup",
    "backup_unsound": "{file}: {store} is not sound ({verdict}); take another backup",
    "store_in_use": "{store} is in use: end the dashboard, then restore",
    "event_stores_restored": "the stores were restored from a backup",
    "backup_of": "{file} of {time}, SHA-256 {digest}",
    "withheld_sessions": "every session has ended",
    "withheld_tokens": "tokens revoked: {names}",
    "withheld_users": "users disabled, as they are or were removed now: {names}",
    "withheld_roles": "users with the lower role of now: {names}",
    "withheld_no_admin": "no admin can sign in; add one with 'lineside user add'",
    "system_error": "{error}",
    "store_closed": "the store {path} is closed; the server is stopping",
    "store_step_failed": "the store {path}: step {step} {called} failed: {error}",
    "store_of_newer_version": (
        "the store {path} was written by a newer version of Lineside (its step {step} {called} is "
        "unknown here); use that version, or restore an older backup"
    ),
    "file_is_link": "{path} is a link, which is not followed; put the file itself there",
    "file_of_other_user": (
        "{path} belongs to another user (uid {uid}), who can read and change it; chown it to the "
        "server's user, or run this as that user"
    ),
    "number_too_large": "a number is too large; nothing was done",
    "search_too_costly": "this takes too long; narrow it by time, kind, bus or unit",
    "store_folder_failed": "the store {path}: {error}; check its folder",
    "stored_text_unreadable": "the stored text cannot be read",
    "store_damaged": "the store {path}: {error}; restore a backup of it",
}
