"""What people do with a shift."""

from __future__ import annotations

from app.core.web.admission.access import Role
from app.people.audit.acts import Act
from app.records.handover.signing.signatures import EVENTS, SignedPart

WRITE_NOTE = Act("write_shift_note", Role.OPERATOR, "shift", "event_shift_note")
CORRECT_NOTE = Act("correct_shift_note", Role.OPERATOR, "shift", "event_shift_note_corrected")
SIGN = Act("sign_shift_sheet", Role.OPERATOR, "shift", EVENTS["leaving"])
TAKE_OVER = Act("take_over_shift", Role.OPERATOR, "shift", EVENTS["coming"])
SIGNATURES: dict[SignedPart, Act] = {"leaving": SIGN, "coming": TAKE_OVER}
ACTS = (WRITE_NOTE, CORRECT_NOTE, *SIGNATURES.values())
