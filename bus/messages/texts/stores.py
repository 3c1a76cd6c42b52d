"""Texts about the stores on disk."""

from __future__ import annotations

from bus.messages.texts.plural import EnglishText

TEXTS: dict[str, EnglishText] = {
    "store_failed": "the store {path}: {reason}",
    "store_disk_full": "the disk is full; nothing was stored; free some space",
    "store_read_only": "it is read-only; give the server's user write access to it and its folder",
    "store_is_damaged": "it is damaged; restore a backup (lineside restore-store) or move it away",
    "store_foreign": ("it is not a Lineside store, or it is damaged; restore a backup or move it away"),
    "store_not_openable": "it cannot be opened; check that its folder exists and is accessible",
    "store_disk_failed": "disk error; check the disk",
    "store_locked": "another program has locked it; stop that program",
    "store_access_refused": "access to it is refused; give the server's user access",
    "store_missing": "there is no store {path}; nothing was served with this configuration yet",
    "stores_missing": "there is no store in {folder}; nothing was served with this configuration yet",
    "backup_exists": "{file} exists already; name another file",
    "backup_malformed": "{file} is not a backup of Lineside's stores, or damaged: {error}",
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
