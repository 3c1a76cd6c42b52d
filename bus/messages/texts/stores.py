"""What is said of the stores on disk."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "store_closed": "the store {path} is closed; the server is ending",
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
    "number_too_large": "a number is larger than any that is stored; nothing was done",
    "search_too_costly": "this takes too long; narrow it by time, kind, bus or unit",
    "store_folder_failed": "the store {path}: {error}; check its folder",
    "stored_text_unreadable": "the stored text cannot be read",
    "store_damaged": "the store {path}: {error}; restore a backup of it",
}
