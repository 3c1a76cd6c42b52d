"""The leaving person signs first, which freezes the sheet; then the coming one signs the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

from pydantic import Field

from app.core.database import Database, StoreConnection
from app.core.web.access import Person
from app.core.web.shape import StrictBody
from app.errors import Problem
from app.people.audit.log import EventLog
from app.people.auth.sign_in import SignIn, WrongSecretError
from app.records.handover import signatures
from app.records.handover.rules.shifts import Shift
from app.records.handover.service import Handover
from app.records.handover.signatures import SIGN, SIGNATURES, SignedPart, SignedSheet
from bus.instants import Clock, UnixTime, unix_now
from bus.messages import Message
from bus.validation import OneLine, TypedText

PageWriter = Callable[[bytes], bytes]
"""Makes the page of a sheet, in the language of the site, from its JSON."""
EARLIEST_S = 1800.0
"""Before the end of a shift: people meet before it."""


class ShiftSignRequest(StrictBody):
    """Who signs what. Without a name it is the user of the session; a token names a user and the password."""

    part: Annotated[
        SignedPart | None, Field(description="leaving, then coming; null: the one that is missing.")
    ] = None
    digest: Annotated[
        str | None, Field(max_length=64, description="Of the signed sheet that was read; checked.")
    ] = None
    name: Annotated[TypedText, Field(max_length=64)] = ""
    password: Annotated[str, Field(max_length=1000)] = ""
    reason: Annotated[
        OneLine,
        Field(max_length=200, description="Why it is signed earlier than half an hour before its end."),
    ] = ""


class Signing:
    """The signatures of a site's shifts."""

    def __init__(
        self,
        handover: Handover,
        database: Database,
        events: EventLog,
        sign_in: SignIn,
        page_of: PageWriter,
        clock: Clock = unix_now,
    ) -> None:
        self._handover = handover
        self._database = database
        self._events = events
        self._sign_in = sign_in
        self._page_of = page_of
        self._clock = clock

    async def sign(self, person: Person, address: str, shift: Shift, request: ShiftSignRequest) -> None:
        """Sign the sheet of a shift. Raises Problem 409 where it is signed already or the other part is due,
        401 for a wrong password, 403 for one who may not sign, and as `Quota.check`."""
        SIGN.check(person)
        self._handover.quota.check(shift)
        signer = await self._signer(person, address, request)
        signed, missing = await self._handover.signed(shift)
        if missing:
            names = ", ".join(each.who for each in missing)
            raise Problem(409, "not_in_state", Message.of("shift_signature_missing", names=names))
        part = request.part or ("leaving" if signed is None else "coming")
        there = {} if signed is None else signed.signatures
        signatures.check_turn(there, part, signer.name, self._handover.zone)
        if signed is None:
            signed = await self._freeze(shift, request.reason.strip())
        elif request.digest not in (None, signed.digest):
            raise Problem(409, "superseded", Message("shift_sheet_differs"), digest=signed.digest)
        elif signed.is_altered:
            raise Problem(409, "not_in_state", Message("shift_sheet_altered"))
        await self._store(signer, part, signed, request.reason.strip())

    def early_until(self, shift: Shift) -> UnixTime | None:
        """Until when only a reason lets a shift be handed over; None: its end is near."""
        earliest = shift.end - EARLIEST_S
        return earliest if self._clock() < earliest else None

    async def _freeze(self, shift: Shift, reason: str) -> SignedSheet:
        earliest = self.early_until(shift)
        if earliest is not None and not reason:
            times = {"end": self._handover.local(shift.end), "earliest": self._handover.local(earliest)}
            raise Problem(409, "not_in_state", Message.of("shift_sign_too_early", **times))
        sheet = (await self._handover.sheet(shift)).sheet
        return SignedSheet(shift, sheet, self._page_of(sheet))

    async def _store(self, signer: Person, part: SignedPart, signed: SignedSheet, reason: str) -> None:
        start, now = signed.shift.start, self._clock()

        def store(connection: StoreConnection) -> None:
            there = signatures.signatures_of(connection, start)
            signatures.check_turn(there, part, signer.name, self._handover.zone)
            if not signed.signatures:
                signatures.freeze(connection, signed)
            signatures.add(connection, start, part, signer.name, now)

        await self._events.record(
            **SIGNATURES[part].by(
                signer,
                start=self._handover.local(start),
                digest=signed.digest,
                page_digest=signed.page_digest,
            ),
            at=now,
            message=reason,
            also=store,
        )

    async def _signer(self, person: Person, address: str, request: ShiftSignRequest) -> Person:
        """Return the user of the name and password, where they are given; else that of the session."""
        if not request.name and not request.password:
            if person.via != "session" or person.panel:
                raise Problem(403, "forbidden", Message("shift_sign_needs_person"))
            return person
        name = request.name.strip()
        if await self._sign_in.has_company_account(name):
            raise Problem(403, "forbidden", Message.of("shift_sign_in_own_session", name=name))
        try:
            user = await self._sign_in.identify(name, request.password, address)
        except WrongSecretError:
            await self._sign_in.note_refusal(name, address)
            raise
        signer = Person(user.name, user.role, person.via)
        SIGN.check(signer)
        return signer
