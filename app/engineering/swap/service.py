"""Unit replacement: choosing what the spare becomes, probing the wire, restoring, and the event at the end.

Swaps continue after a restart. Units are only read here; a restore writes.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

from app.core.web.admission.access import Person, account_shown
from app.engineering.sets.comparison.sides import side
from app.engineering.sets.lookup import FormSource
from app.engineering.sets.model import ParameterSet
from app.engineering.sets.restore.record import Restore
from app.engineering.sets.restore.restores import RestoreService
from app.engineering.sets.saving.keeper import SetKeeper
from app.engineering.sets.saving.reading import status_of
from app.engineering.sets.store import SetStore
from app.engineering.swap.acts import BEGIN, CANCEL, CONFIRM_SPARE, RESTORE_SPARE, SAVE_ENTERED
from app.engineering.swap.record import Swap, SwapSource
from app.engineering.swap.rules import FACTORY_ADDRESS, Advice, ProbeFinding, SwapState
from app.engineering.swap.store import SwapStore
from app.errors import Problem, StoreError
from app.line.commands.api.responses import outcome_message
from app.line.commands.service.command_service import CommandService
from app.line.live.state.bus_live import LiveState
from app.people.audit.log import EventLog
from bus.contract import ScanBus
from bus.instants import Clock
from bus.messages import Message, joined, listed, parameter_name

LOOK_WAIT_S = 2.0
"""How long a page waits for a probe before it shows the previous finding."""


class SwapService:
    """Keeps the swap of each unit, until it is ended or another of the unit begins."""

    def __init__(self, events: EventLog, store: SwapStore, restores: RestoreService, clock: Clock) -> None:
        self._events = events
        self._store = store
        self._clock = clock
        self._swaps: dict[tuple[str, int], Swap] = {}
        self._restores = restores
        restores.on_end(self.on_restore_end)

    async def load(self, bus: str) -> None:
        """Take up, after the restores, what was under way when the last run ended."""
        self._swaps = {place: swap for place, swap in self._swaps.items() if swap.bus != bus}
        for swap in await self._store.load(bus, self._restores.find):
            self._swaps[swap.bus, swap.unit] = swap

    def of(self, bus: str, unit: int) -> Swap | None:
        """The swap of a section, under way or just ended."""
        return self._swaps.get((bus, unit))

    def of_or_404(self, bus: str, unit: int) -> Swap:
        """The swap of a section. Raises Problem 404 where none is begun."""
        swap = self.of(bus, unit)
        if swap is None:
            raise _not_begun(unit)
        return swap

    def _refuse_closed(self, swap: Swap) -> None:
        """Raise Problem 404 where it was closed while its unit was read: another may have begun since."""
        if self.of(swap.bus, swap.unit) is not swap:
            raise _not_begun(swap.unit)

    async def begin(self, person: Person, bus: str, unit: int, source: SwapSource | None) -> Swap:
        """Begin the swap of a section's unit; ``source`` is what the spare shall become.

        Raises Problem 409 where another swap of it is under way.
        """
        BEGIN.check(person)
        under_way = self.of(bus, unit)
        if under_way is not None and not under_way.proven:
            other = Message.of("swap_under_way", who=account_shown(under_way.who), unit=unit)
            raise Problem(409, "busy", other)
        swap = Swap(bus, unit, person.name, source, self._clock())
        # Before the wait for the store: of two who begin at once, one is refused.
        self._swaps[bus, unit] = swap
        try:
            await self._store.save(swap)
        except StoreError:
            self._swaps.pop((bus, unit))
            raise
        performed = BEGIN.by(person, source=swap.source_message)
        await self._events.record(**performed, bus=bus, unit=unit)
        return swap

    async def look(self, swap: Swap, look: Callable[[], Coroutine[Any, Any, SwapState]]) -> SwapState | None:
        """The finding on the wire, or the previous one where a probe takes long; None before the first.

        One probe at a time: it takes the gaps of the scan, and a page that is reloaded must not pile up more.
        Raises the Problem that ended the probe.
        """
        running = swap.look = swap.look or asyncio.create_task(
            look(), name=f"look for the spare of {swap.unit}"
        )
        done, _ = await asyncio.wait({running}, timeout=LOOK_WAIT_S)
        if done and swap.look is running:
            swap.look = None
            if swap.saw(running.result()) and self.of(swap.bus, swap.unit) is swap:
                await self._store.save(swap)
        if swap.state is None:
            return None
        return replace(swap.state, is_new=swap.is_new, equal=swap.equal)

    async def confirm_spare(self, person: Person, swap: Swap) -> None:
        """A person confirmed that the unit at the section's address is the spare."""
        CONFIRM_SPARE.check(person)
        self._refuse_closed(swap)
        swap.is_new = True
        swap.seen.append(Message(CONFIRM_SPARE.event))
        await self._store.save(swap)

    async def begin_restore(self, person: Person, swap: Swap, restore: Restore) -> None:
        """The restore of it has been planned."""
        RESTORE_SPARE.check(person)
        self._refuse_closed(swap)
        swap.restore = restore
        await self._store.save(swap)

    async def cancel(self, person: Person, swap: Swap) -> None:
        """Close a swap that is not continued, or that was verified."""
        CANCEL.check(person)
        self._refuse_closed(swap)
        del self._swaps[swap.bus, swap.unit]
        await self._store.remove(swap)
        if not swap.proven:
            performed = CANCEL.by(person)
            await self._events.record(**performed, bus=swap.bus, unit=swap.unit, message=swap.story)

    async def on_restore_end(self, restore: Restore) -> None:
        """A restore is over: where it belongs to a swap and the full read was equal, so is the swap. What a
        restore of another set finds equal is nothing about the set of the swap."""
        swap = self.of(restore.bus, restore.unit)
        if swap is None or not restore.for_swap or restore.planned_at < swap.began_at or swap.proven:
            return
        swap.restore = restore
        swap.proven = restore.state == "equal"
        await self._store.save(swap)
        if not swap.proven:
            return
        account = restore.account() or Message("restore_wrote_nothing")
        left_out = [Message.of("at_row", number=left.number, why=left.text) for left in restore.left_out]
        story = [
            swap.story,
            Message.of("swap_restored", source=swap.source_message, account=account),
            Message.of("rows_left_out", rows=listed(left_out)) if left_out else None,
            Message("proven_by_full_read"),
        ]
        await self._events.record(
            kind=RESTORE_SPARE.kind,
            who=restore.who,
            bus=swap.bus,
            unit=swap.unit,
            what=Message(RESTORE_SPARE.event),
            message=joined(story) or "",
            outcome="verified",
        )

    async def save_entered(self, person: Person, swap: Swap, kept: ParameterSet) -> None:
        """Everything was entered from the sheet, and the complete unit was read and saved as ``kept``."""
        SAVE_ENTERED.check(person)
        self._refuse_closed(swap)
        swap.proven = True
        await self._store.save(swap)
        story = joined([swap.story, Message("entered_from_sheet"), Message.of("kept_as_set", set=kept.id)])
        await self._events.record(
            **SAVE_ENTERED.by(person), bus=swap.bus, unit=swap.unit, message=story or "", outcome="verified"
        )


def _not_begun(unit: int) -> Problem:
    return Problem(404, "unknown_swap", Message.of("swap_not_begun", unit=unit))


def step_text(advice: Advice, swap: Swap) -> Message:
    """What to do; of a restore that was tried how it ended, of a sheet what to do with it."""
    if swap.source is None and advice.step == "restore":
        return Message("swap_enter_sheet")
    if swap.source is None and advice.step == "proven":
        return Message("swap_compare_with_sheet")
    if advice.step == "proven" and (kept := swap.not_restored):
        return Message.of("swap_proven_except", rows=listed([parameter_name(number) for number in kept]))
    if advice.step == "restore" and swap.restore is not None and swap.equal is False:
        return Message("swap_restore_unfinished")
    return advice.text


LOOK_TIMEOUT_S = 30.0
MAX_PROBES = 4
"""Attempts at an address whose unit still responds to the scan."""


async def look(commands: CommandService, live: LiveState, person: Person, swap: Swap) -> SwapState:
    """Probe the wire. Raises Problem 503 where it cannot: the bus is closed, or too busy."""
    bus, target = swap.bus, swap.unit
    at_target = await _at_section(commands, live, person, bus, target)
    at_factory: ProbeFinding = "silent"
    if at_target == "silent" and target != FACTORY_ADDRESS:
        at_factory = await _probe(commands, person, FACTORY_ADDRESS)
    line, unit = live.buses[bus], live.buses[bus].units[target]
    # REMOTE counts as the unit reported it since it came back.
    is_back = at_target == "digimax" and unit.link.link == "online"
    status = status_of(line, unit) if is_back else None
    return SwapState(
        target=target,
        at_target=at_target,
        at_factory=at_factory,
        remote=None if status is None else status.remote,
        equal=swap.equal,
        is_new=swap.is_new,
        configured=frozenset(line.units),
        baud=line.baud,
    )


async def _at_section(
    commands: CommandService, live: LiveState, person: Person, bus: str, unit: int
) -> ProbeFinding:
    """One lost response is no absence: it would let the old unit, still on the cable, pass for the spare."""
    for _ in range(MAX_PROBES):
        kind = await _probe(commands, person, unit)
        if kind != "silent" or live.buses[bus].units[unit].link.link != "online":
            return kind
    return "silent"


async def _probe(commands: CommandService, person: Person, address: int) -> ProbeFinding:
    action = ScanBus(first=address, last=address)
    result = await commands.send(person, action, timeout_s=LOOK_TIMEOUT_S, origin="unit swap")
    if result.outcome != "verified":
        raise Problem(503, "not_looked", outcome_message(result))
    return next((found.kind for found in result.found if found.unit == address), "silent")


SHEET = "sheet"
"""Nothing is stored: a person enters the values."""


async def source_of(
    person: Person,
    keepers: Callable[[str], SetKeeper],
    sets: SetStore,
    live: LiveState,
    bus: str,
    unit: int,
    form: FormSource,
) -> SwapSource | None:
    """What the form chooses, as a stored set: a neighbor is read now, a file is kept. None: the sheet.

    ``keepers``: by bus. Raises Problem 403, 404, 422 or 504.
    """
    BEGIN.check(person)
    if form.file and (rows := await form.uploaded(unit)):
        name = (form.file.filename or "")[:80]
        kept = await keepers(bus).keep(person, [rows], name, "", "from a file")
        return SwapSource(kept.id, rows.unit)
    if form.text == SHEET:
        return None
    if not form.text:
        raise Problem(422, "invalid", Message("spare_not_chosen"))
    chosen = await side(form.text, sets, live)
    if chosen.kind == "set":
        return SwapSource(int(chosen.of), chosen.unit)
    kept = await keepers(chosen.of).take(person, [chosen.unit], "", "", "for a unit swap")
    return SwapSource(kept.id, chosen.unit)
