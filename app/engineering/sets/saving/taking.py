"""Reading many units for one set: takes the gaps of the scan, so it goes on in the background."""

from __future__ import annotations

import asyncio
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from app.core.web.admission.access import Person
from app.engineering.sets.acts import MARK_GOLDEN, SAVE
from app.engineering.sets.model import UnitRows
from app.engineering.sets.saving.background import Background
from app.engineering.sets.saving.keeper import SetKeeper
from app.errors import Problem, StoreError
from bus.catalogue.parameters import PARAMETERS
from bus.instants import UnixTime, unix_now
from bus.messages import Message

MAX_TAKINGS = 20
"""Readings whose progress is kept."""
MAX_AT_ONCE = 4
"""Reads of several units take turns on the wire, which saves the fence between two reads of one."""


@dataclass(slots=True)
class Taking:
    """A set being read since ``began``, to be the ``golden`` set of its units or not. ``set_id`` once it is
    saved; ``missing``: the units that did not respond, with the reason; ``cause``: why it was not saved, or
    not marked, although units responded."""

    id: str
    bus: str
    units: tuple[int, ...]
    name: str
    comment: str
    golden: bool
    began: UnixTime
    state: Literal["reading", "kept", "failed"] = "reading"
    read: list[UnitRows] = field(default_factory=list)
    missing: dict[int, Message] = field(default_factory=dict)
    set_id: int | None = None
    cause: Message | None = None

    def values_read(self, keeper: SetKeeper) -> dict[int, int]:
        """How many values of each unit have been read so far; all of a unit that will not be read further."""
        ended = self.missing.keys() | {rows.unit for rows in self.read}
        return {
            unit: len(PARAMETERS) if unit in ended else keeper.reader.values_since(unit, self.began)
            for unit in self.units
        }


class Takings:
    """Begins readings and remembers how they went."""

    def __init__(self) -> None:
        self._takings: dict[str, Taking] = {}
        self.background = Background()

    def get(self, taking_id: str) -> Taking | None:
        """A reading begun since the server started."""
        return self._takings.get(taking_id)

    def begin(
        self,
        person: Person,
        keeper: SetKeeper,
        units: Sequence[int],
        name: str,
        comment: str,
        *,
        golden: bool = False,
    ) -> Taking:
        """Read the units one after another and save their values as one set; ``golden``: and mark it as the
        golden set of each unit that was read."""
        SAVE.check(person)
        if golden:
            MARK_GOLDEN.check(person)
        taking = Taking(secrets.token_hex(8), keeper.bus, tuple(units), name, comment, golden, unix_now())
        self._takings[taking.id] = taking
        for old in list(self._takings)[:-MAX_TAKINGS]:
            del self._takings[old]
        self.background.begin(self._run(person, keeper, taking), f"parameter set {taking.id}")
        return taking

    async def _run(self, person: Person, keeper: SetKeeper, taking: Taking) -> None:
        await read_together(keeper, person, taking.units, taking.read, taking.missing)
        if not taking.read:
            taking.state = "failed"
            return
        try:
            kept = await keeper.keep(person, taking.read, taking.name, taking.comment, "by hand")
            taking.set_id = kept.id
            if taking.golden:
                await keeper.mark_golden(person, kept, [rows.unit for rows in taking.read])
        except (Problem, StoreError) as error:
            taking.state, taking.cause = "failed", error.message
            return
        taking.state = "kept"


async def read_together(
    keeper: SetKeeper,
    person: Person,
    units: Sequence[int],
    read: list[UnitRows],
    missing: dict[int, Message],
) -> None:
    """Read units completely, a few at once: on the way ``read`` gets those that responded, and ``missing``
    why the others did not."""
    at_once = asyncio.Semaphore(MAX_AT_ONCE)

    async def read_one(unit: int) -> None:
        async with at_once:
            try:
                read.append(await keeper.reader.read_unit(person, unit))
            except (Problem, StoreError) as error:
                missing[unit] = error.message

    await asyncio.gather(*(read_one(unit) for unit in units))
    read.sort(key=lambda rows: units.index(rows.unit))
