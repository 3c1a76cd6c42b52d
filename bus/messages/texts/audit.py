"""Texts about the audit log, its key and its anchor."""

from bus.messages.texts.plural import EnglishText, Plural

TEXTS: dict[str, EnglishText] = {
    "audit_key_unreadable": "the audit key {path} cannot be read: {reason}; run this as the server's user",
    "audit_key_is_link": "it is a link, name the file itself",
    "audit_key_not_made": (
        "the audit key {path} cannot be made: {error}; give the server's user write access to that folder "
        "for the first start, or name another place as key_file in [audit]"
    ),
    "audit_key_not_replaced": "the audit key {path} cannot be replaced: {error}",
    "audit_key_no_file": "the audit key {path} is not a file; name one as key_file in [audit]",
    "audit_key_of_other_user": (
        "the audit key {path} belongs to another user, who can read and replace it; "
        "move it away, then start again: a new one is made"
    ),
    "audit_key_open_to_others": (
        "the audit key {path} can be read or written by others, who may know it now; "
        "chmod 600 {path}, then lineside audit rotate-key"
    ),
    "audit_key_replaceable": (
        "every user can replace the audit key {path}; chmod o-w {folder}, "
        "or name another place as key_file in [audit]"
    ),
    "audit_key_damaged": (
        "the audit key {path} is damaged ({error}); restore it from your backup, or move it "
        "away: then a new key is made, and entries sealed with the old key can no longer be "
        "verified before that moment"
    ),
    "audit_key_removed": "the audit key {path} was removed while it was read; start again",
    "audit_key_missing": "there is no audit key {path}, and the log is sealed; restore your copy of it",
    "anchor_failed": "the anchor {path} cannot be used: {reason}; check anchor in [audit]",
    "anchor_is_link": "it is a link",
    "anchor_no_file": "it is not a file",
    "anchor_no_response": "it does not respond",
    "anchor_line_forged": "line {line} of {path} was not written with the key; compare a copy",
    "anchor_lines_unreadable": Plural(
        "1 line of the anchor cannot be read and was skipped",
        "{n} lines of the anchor cannot be read and were skipped",
    ),
    "anchors_hold": Plural(
        ("1 anchor matches, at entry {newest}: whether later entries were cut off cannot be verified"),
        (
            "{n} anchors match, the newest at entry {newest}: whether later entries were cut off "
            "cannot be verified"
        ),
    ),
    "audit_anchor_missed": "Since {time} the audit log is not anchored. The reason: {reason}",
    "audit_altered_after_anchor": (
        "The audit log was altered after it was anchored. Run lineside audit verify."
    ),
    "audit_whole": Plural("the audit log is intact: 1 entry", ("the audit log is intact: {n} entries")),
    "audit_unsealed": (
        "entries 1 to {last} are older than the key: they are unchanged since it was made, and "
        "cannot be verified for the time before"
    ),
    "audit_broken": "the audit log is broken at entry {entry}: {fault}; compare a backup",
    "audit_entry_missing": "entry {entry} is missing; after {before} comes {found}",
    "audit_entry_apart": "entry {entry} does not continue the one before it",
    "audit_entry_changed": "entry {entry} was changed after it was written",
    "audit_entry_not_anchored": "entry {entry} is not the one that the anchor names",
    "audit_entry_not_original": "entry {entry} is not the one that was there when the key was made",
    "audit_entry_without_key": "entry {entry} is not sealed with a key of the key file",
    "audit_entry_older_key": "entry {entry} is sealed with an older key than the entry before it",
    "audit_entry_not_sealed": "the seal of entry {entry} does not hold: it was not written with the key",
    "audit_entry_notes_alteration": "entry {entry} notes that the end of the log was altered before it",
    "audit_entry_not_newest": "entry {entry} is not the one that was noted as the newest",
    "audit_end_before_newest": "the log ends at entry {entry}, but {written} were written",
    "audit_end_before_key": "the log ends at entry {entry}, but {written} were there when the key was made",
    "audit_log_cut_off": (
        "the log was emptied or cut off: it has no entry {entry}, which {path} names; if the data was "
        "replaced on purpose, move that file away and keep it as evidence"
    ),
    "audit_signature_missing": (
        "entry {entry} states that {who} signed the shift of {start}, and the store has no such signature; "
        "compare a backup"
    ),
    "anchor_put_aside": "the anchor of the log that was replaced is kept as {path}",
    "anchor_outlives_restore": (
        "the anchor {path} may name entries that came after the backup: keep it as evidence, and name "
        "another file as anchor in [audit]"
    ),
    "anchor_of_former_site": (
        "the anchor {path} is of the former site; nothing was begun. Keep it as evidence, and name another "
        "file as anchor in [audit]"
    ),
    "restored_over": "the audit log that was replaced ended at entry {entry}, {hash}",
    "audit_end_before_anchor": "the log ends at entry {entry}, but the anchor names entry {named}",
    "audit_end_not_sealed": "the log ends at entry {entry}, but what notes that end is not sealed",
    "audit_newest_key_unused": "no entry is sealed with the newest key: the log ends before that key",
    "event_audit_sealed": "the audit log is sealed with a key from here on",
    "event_audit_other_key": "the audit log is sealed with another key from here on",
    "event_audit_end_altered": "the end of the audit log was altered before this entry",
    "event_audit_altered": "audit log altered",
    "event_anchor_not_written": "audit anchor not written",
    "event_anchor_written": "audit anchor written again",
    "event_audit_key_rotated": "audit key rotated",
    "audit_verify_names_entry": "lineside audit verify names the entry",
}
