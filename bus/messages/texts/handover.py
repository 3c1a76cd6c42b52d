"""Shift hand-over: notes and sheets."""

TEXTS = {
    "shift_unknown": "No shift starts at {time}. The shift of that time starts at {start}.",
    "shift_not_begun": "That shift has not begun.",
    "shift_note_empty": "The note has no text. Nothing was stored. Write one.",
    "shift_note_needs_time": (
        "The shift is over. Nothing was stored. State the time in the shift that the note is about."
    ),
    "shift_note_outside": (
        "A note of this shift is about a time from {start} to {end}, and not later than now. Nothing was "
        "stored."
    ),
    "shift_note_unit_without_bus": "A unit needs its bus.",
    "shift_note_unknown": "The shift has no note {note}.",
    "shift_note_superseded": (
        "Note {note} was corrected by note {newer}. Nothing was stored. Correct that one instead."
    ),
    "shift_note_key_of_other": "The key was used for another note. Nothing was stored. Send another key.",
    "shift_notes_full": (
        "The shift has {n} notes, which is as many as a sheet may have. Nothing was stored. Write it in the "
        "next shift."
    ),
    "shift_too_old": (
        "The shift ended more than {n} days ago. Nothing was stored. Write a note in the shift under way."
    ),
    "shift_disk_full": "The disk is full. Nothing was stored. Free some space.",
    "shift_quota_used": (
        "One person stores {n} notes and pictures in an hour. Nothing was stored. Try again later."
    ),
    "shift_notes_of_site_full": "The site has {n} notes, the most that are stored. Nothing was stored.",
    "pictures_of_site_full": (
        "The pictures of the site take {n} MB, the most that are stored. Nothing was stored. An "
        "administrator can raise pictures_mb in the configuration."
    ),
    "shift_omits_before_record": (
        "The record begins after the start of the shift. Nothing is known of the time before."
    ),
    "shift_omits_downtime": "Nothing is recorded from {last} to {start}, when the server was started.",
    "shift_omits_quality": (
        "The journal of alarms does not hold until when an alarm is shelved, nor whether its condition was "
        "known."
    ),
    "shift_omits_drift": (
        "Drift is judged for units with a golden set only: when the sheet was made, {golden} of {units} "
        "units had one."
    ),
    "shift_omits_control": "This site does not require control: every operator may send commands.",
    "shift_omits_lapse": (
        "Control that lapsed 10 minutes after the last command, or with the server, is not recorded as "
        "released."
    ),
    "picture_of_other_kind": "The file is no JPEG, PNG or WebP picture. Nothing was stored.",
    "picture_damaged": "The picture is damaged or incomplete. Nothing was stored.",
    "picture_too_large": "The picture has {width} by {height} pixels. Nothing was stored. Reduce it.",
    "picture_too_long": "A picture may have {n} MB. Nothing was stored. Reduce it.",
    "picture_not_base64": "A picture is sent in base64. Nothing was stored.",
    "pictures_too_many": "A note may have {n} pictures. Nothing was stored. Write another note.",
    "shift_pictures_full": "The notes of a shift may have {n} pictures. Nothing was stored.",
    "no_such_picture": "There is no such picture.",
    "event_shift_note": "note for the shift of {start}",
    "event_shift_note_corrected": "note {note} of the shift of {start} corrected",
    "shift_already_signed": "{who} signed as the {part} person on {time}. Nothing was signed.",
    "shift_not_signed_over": "Nothing was signed. The leaving person signs first, and has not signed yet.",
    "shift_same_person": "{who} has signed the other part. Nothing was signed. Another person signs this.",
    "shift_sheet_differs": "The sheet is not the one that was read. Nothing was signed. Read it, then sign.",
    "shift_signature_missing": (
        "The audit log names signatures of this shift that are gone from the store: {names}. "
        "Nothing was signed. Compare a backup."
    ),
    "shift_sheet_altered": "The stored sheet is not the one that the audit log names. Nothing was signed.",
    "shift_sign_too_early": (
        "The shift ends on {end}. Nothing was signed. Its sheet can be signed from {earliest} on."
    ),
    "shift_sign_needs_person": (
        "A person signs. Nothing was signed. Log in as that person, or enter name and password."
    ),
    "event_shift_signed_over": "shift of {start} handed over: sheet {digest}, page {page_digest}",
    "event_shift_taken_over": "shift of {start} taken over: sheet {digest}, page {page_digest}",
}
