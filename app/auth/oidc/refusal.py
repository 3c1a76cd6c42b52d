"""Why a sign-in by a company account did not come about, in words for the login page."""

from __future__ import annotations

from typing import Literal, get_args

from bus.messages import Message

NotAdmittedReason = Literal[
    "away",
    "busy",
    "canceled",
    "disabled",
    "expired",
    "groups",
    "name",
    "name_taken",
    "provider",
    "token",
]
"""The part of the address of the login page that names the reason: never a text of others."""
REFUSALS: tuple[NotAdmittedReason, ...] = get_args(NotAdmittedReason)
COUNTED: frozenset[NotAdmittedReason] = frozenset({"disabled", "groups", "name", "name_taken", "token"})
"""Refusals that are events, as a wrong password is: the provider has responded, and Lineside refuses."""


class NotAdmittedError(Exception):
    """``reason``: shown to the person; ``detail``: for the log and the event; ``name``: of the account, once
    it is known."""

    def __init__(self, reason: NotAdmittedReason, detail: str = "", name: str = "") -> None:
        super().__init__(reason)
        self.reason: NotAdmittedReason = reason
        self.detail = detail
        self.name = name


def refusal_shown(reason: str) -> Message | None:
    """The text for a reason in an address; None for one that there is not."""
    return Message(f"company_account_{reason}") if reason in REFUSALS else None
