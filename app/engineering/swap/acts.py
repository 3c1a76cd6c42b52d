"""What people do to replace a unit. Its restore writes parameters, whose role each step needs."""

from __future__ import annotations

from app.line.commands.catalogue import WRITE_PARAMETER
from app.people.audit.acts import Act

BEGIN = Act("begin_swap", WRITE_PARAMETER.role, "swap", "event_swap_begun")
CONFIRM_SPARE = Act("confirm_spare", WRITE_PARAMETER.role, "swap", "swap_named_by_person")
RESTORE_SPARE = Act("restore_spare", WRITE_PARAMETER.role, "swap", "event_swap_proven")
"""Recorded when a full read of the spare was equal."""
SAVE_ENTERED = Act("save_entered_spare", WRITE_PARAMETER.role, "swap", "event_swap_kept")
CANCEL = Act("cancel_swap", WRITE_PARAMETER.role, "swap", "event_swap_given_up")
ACTS = (BEGIN, CONFIRM_SPARE, RESTORE_SPARE, SAVE_ENTERED, CANCEL)
